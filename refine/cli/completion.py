"""``refine completion``: a script for a shell that completes verbs, flags, choices, built-in actions and files at Tab.

A script holds all the words there are: Tab starts no Python.
"""

from collections.abc import Iterable, Iterator
from typing import Literal

from refine.cli.grammar import Command, Flag

Shell = Literal["bash", "zsh", "fish"]
FILES = "\0files"  # among offers: files as well
BASH_FOLDER, FISH_FOLDER = "~/.local/share/bash-completion/completions", "~/.config/fish/completions"
INSTALL = {
    "bash": f"mkdir -p {BASH_FOLDER} && refine completion bash > {BASH_FOLDER}/refine",
    "zsh": "refine completion zsh > ~/.refine.zsh && echo 'source ~/.refine.zsh' >> ~/.zshrc",
    "fish": f"mkdir -p {FISH_FOLDER} && refine completion fish > {FISH_FOLDER}/refine.fish",
}


def script(shell: Shell, root: Command, actions: Iterable[str] = ()) -> str:
    """The script for a shell.

    Args:
        actions: names that are offered, beside files, where a motion is wanted.
    """
    actions, commands = tuple(actions), list(root.every())
    head = f"# Tab completion for refine. To keep it, then in new shells:\n#   {INSTALL[shell]}\n"
    if shell == "fish":
        return head + "\n".join(_fish(commands, actions)) + "\n"
    return head + (ZSH if shell == "zsh" else "") + _bash(commands, actions)


def flags_of(command: Command) -> list[str]:
    return ["--help", *(name for flag in command.flags if not flag.positional for name in flag.names)]


def offers(flag: Flag, actions: tuple[str, ...]) -> list[str]:
    """What to offer for a flag's value, or for a word in its place: choices, actions, `FILES`, or nothing."""
    if flag.choices:
        return list(flag.choices)
    if "built-in action" in flag.said:
        return [*actions, *([] if flag.names == ("--actions",) else [FILES])]
    return [FILES] if "PATH" in flag.value else []


# --- bash, and zsh which understands it ------------------------------------------------------------------------------

ZSH = """\
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }
autoload -Uz bashcompinit && bashcompinit
"""
BASH = """\
_refine() {{
  local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}} at= offers= files= i
  COMPREPLY=()
  for ((i = 1; i < COMP_CWORD; i++)); do
    case "$at/${{COMP_WORDS[i]}}" in
      {commands}) at="$at/${{COMP_WORDS[i]}}" ;;
    esac
  done
  case "$at $prev" in
    {values}
    *)
      case "$at $cur" in
        {flags}
        {places}
      esac ;;
  esac
  COMPREPLY=($(compgen -W "$offers" -- "$cur"))
  if [ -n "$files" ]; then
    local IFS=$'\\n'
    COMPREPLY+=($(compgen -f -- "$cur"))
    compopt -o filenames 2> /dev/null
  fi
}}
complete -F _refine refine
"""


def _bash(commands: list[Command], actions: tuple[str, ...]) -> str:
    """A function that walks the words to the last command, and then knows what may follow.

    It has no tables, as bash 3.2, which macOS has, knows none.
    """
    path = {command.name: "".join(f"/{word}" for word in command.name.split()) for command in commands}
    values: dict[str, list[str]] = {}  # patterns by what is offered
    flags, places = [], []
    for command in commands:
        at = path[command.name]
        for flag in command.flags:
            if flag.value and not flag.positional:
                values.setdefault(_offer(offers(flag, actions)), []).extend(f'"{at} {name}"' for name in flag.names)
        flags.append(f'"{at} -"*) {_offer(flags_of(command))} ;;')
        wanted = list(command.commands)
        for flag in command.flags:
            wanted += [each for each in offers(flag, actions) if flag.positional and each not in wanted]
        if wanted:
            places.append(f'"{at} "*) {_offer(wanted)} ;;')
    return BASH.format(
        commands="|".join(f'"{at}"' for at in path.values() if at),
        values="\n    ".join(f"{'|'.join(patterns)}) {offer} ;;" for offer, patterns in values.items()),
        flags="\n        ".join(flags),
        places="\n        ".join(places),
    )


def _offer(words: list[str]) -> str:
    """The commands that offer words, and files if they are among them."""
    named = " ".join(word for word in words if word != FILES)
    said = [f'offers="{named}"'] if named else []
    return "; ".join([*said, *(["files=1"] if FILES in words else [])]) or ":"


# --- fish ------------------------------------------------------------------------------------------------------------


def _fish(commands: list[Command], actions: tuple[str, ...]) -> Iterator[str]:
    """A line for each thing that may be typed, with its description, under the condition of where."""
    known = " ".join("".join(f"/{word}" for word in command.name.split()) for command in commands if command.name)
    yield "function __refine_at"
    yield "    set -l at ''"
    yield "    for word in (commandline -opc)[2..]"
    yield f"        contains -- $at/$word {known}; and set at $at/$word"
    yield "    end"
    yield '    test "$at" = "$argv[1]"'
    yield "end"
    yield "complete -c refine -f"
    for command in commands:
        at = "".join(f"/{word}" for word in command.name.split())
        start = f"complete -c refine -n \"__refine_at '{at}'\""
        yield f"{start} -l help -d 'show help and exit'"
        for word, below in command.commands.items():
            yield f"{start} -a {word} -d {_quoted(_summary(below.said))}"
        for flag in command.flags:
            wanted = offers(flag, actions)
            words = _quoted(" ".join(word for word in wanted if word != FILES))
            files = " -F" if FILES in wanted else ""
            if flag.positional:
                yield f"{start} -a {words}{files}" if words != "''" else f"{start}{files}"
                continue
            names = " ".join(f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in flag.names)
            takes = " -r -F" if files else " -x"
            value = takes + (f" -a {words}" if words != "''" else "") if flag.value else ""
            yield f"{start} {names}{value} -d {_quoted(_summary(flag.said))}"


def _summary(text: str) -> str:
    """The first sentence, in one line."""
    return " ".join(text.split()).partition(". ")[0].rstrip(".")[:100]


def _quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
