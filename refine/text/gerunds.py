"""English verbs in their -ing form, so that "walk" and "take a bow" can go on as "walking while taking a bow".

The released code of SINC puts "ing" behind the second token that a tagger takes for a verb ("takeing"); here the verb
is found, every verb that is joined to it goes along, and the spelling is English.
"""

import re

VOWELS = "aeiou"
# Of more than one syllable with the stress on the last one; all others keep a single consonant.
DOUBLED = {"begin", "forget", "prefer", "permit", "refer", "admit", "commit", "occur", "kidnap", "regret", "unwrap"}
DOUBLED |= {"unzip", "babysit", "outrun", "rerun", "unplug", "unclip", "sidestep"}
SPELT = {
    "be": "being", "dye": "dyeing", "singe": "singeing", "swinge": "swingeing", "mimic": "mimicking",
    "panic": "panicking", "picnic": "picnicking", "frolic": "frolicking", "traffic": "trafficking", "bus": "bussing",
    "age": "ageing", "whinge": "whingeing",
}  # fmt: skip
THIRD = {"is": "be", "are": "be", "am": "be", "was": "be", "were": "be", "has": "have", "does": "do", "goes": "go"}
SUBJECT = re.compile(
    r"^(?:(?:the|a|an|this|that|another) )?(?:\w+ )?(?:person|man|woman|human|figure|someone|somebody|guy|he|she|they|"
    r"character|subject|individual|people|girl|boy|body|actor|dancer)\b(?: (?:who|that))? +",
    re.IGNORECASE,
)
AUXILIARY = re.compile(r"^(?:is|are|was|were)(?: (?:slowly|quickly|now|then|still|also|just))? +(?=\w+ing\b)", re.I)
# What a phrase that names a movement by a noun begins with.
DETERMINERS = {"a", "an", "the", "some", "another", "several", "two", "three", "one", "both", "his", "her", "their"}
NOT_VERBS = DETERMINERS | {
    "left", "right", "in", "on", "with", "at", "to", "from", "by", "of", "for", "into", "over", "under", "around",
    "forward", "forwards", "backward", "backwards", "sideways", "up", "down", "upper", "lower", "full", "double",
    "single", "high", "low", "big", "small", "t-pose", "a-pose", "t", "pose", "arm", "arms", "leg", "legs", "knee",
    "knees", "torso", "head", "hands", "feet", "side", "jazz", "ballet", "martial", "basketball", "football", "tennis",
    "golf", "baseball", "karate", "yoga", "gymnastics", "aerobics", "animal", "star",
}  # fmt: skip
ADVERBS = {
    "slowly", "then", "also", "just", "now", "still", "again", "fast", "first", "almost", "once", "twice", "not",
    "never", "simultaneously",
}  # fmt: skip
JOINED = {"and", "or", "then", "but"}
BEFORE_GERUNDS = {"keep", "start", "stop", "begin", "go", "try", "practice", "practise", "finish", "continue"}
# After "and", these go on with what was said of the last verb: "wave left and right".
OBJECTS = NOT_VERBS | {
    "it", "them", "hand", "foot", "elbow", "elbows", "shoulder", "shoulders", "hips", "hip", "neck", "face", "chest",
    "fro", "out", "back", "off", "away", "ball", "box", "cup", "chair", "object", "objects", "something", "thigh",
    "thighs", "ankles", "wrists", "fingers", "eyes", "ears", "nose", "mouth", "hair", "body", "waist", "again",
    "across", "through", "ground", "floor", "table", "wall", "others", "so", "all", "apart", "together", "above",
    "below", "behind",
}  # fmt: skip


def gerund(verb: str) -> str:
    """The -ing form of a verb's base form.

    >>> [gerund(verb) for verb in ("walk", "take", "run", "lie", "see", "open", "begin", "mimic", "quit", "tiptoe")]
    ['walking', 'taking', 'running', 'lying', 'seeing', 'opening', 'beginning', 'mimicking', 'quitting', 'tiptoeing']
    """
    low = verb.lower()
    if "-" in verb and verb.rpartition("-")[2]:
        head, _, tail = verb.rpartition("-")
        return f"{head}-{gerund(tail)}"
    if low in SPELT:
        made = SPELT[low]
    elif re.search(r"[aeiouy]\w*ing$", low):  # "bring" and "swing" have no other vowel
        return verb
    elif low.endswith("ie"):
        made = low[:-2] + "ying"
    elif low.endswith("e") and not low.endswith(("ee", "oe", "ye")) and len(low) > 2:
        made = low[:-1] + "ing"
    elif doubles(low):
        made = low + low[-1] + "ing"
    else:
        made = low + "ing"
    return made.capitalize() if verb[0].isupper() else made


def doubles(verb: str) -> bool:
    """Whether the last consonant is doubled: one syllable (or the last one stressed), one vowel letter, one consonant
    that is not w, x or y."""
    if verb in DOUBLED:
        return True
    syllables = re.findall(r"[aeiouy]+", re.sub(r"^y|qu", "q", verb))
    return len(syllables) == 1 and re.search(r"(?:^|[^aeiou]|qu)[aeiouy][^aeiouwxy]$", verb) is not None


def base_of(verb: str) -> str:
    """The base form of a third person's verb.

    >>> [base_of(verb) for verb in ("walks", "goes", "carries", "pushes", "dances", "passes", "walk", "press")]
    ['walk', 'go', 'carry', 'push', 'dance', 'pass', 'walk', 'press']
    """
    low = verb.lower()
    if low in THIRD:
        return THIRD[low]
    if low.endswith("ies") and len(low) > 4:
        return low[:-3] + "y"
    if re.search(r"(?:sh|ch|ss|x|zz|o)es$", low):
        return low[:-2]
    if low.endswith("s") and not low.endswith(("ss", "us", "is")):
        return low[:-1]
    return low


def as_gerund(phrase: str) -> str:
    """A description of an action as it goes on after "while".

    A sentence about a person loses its subject. Verbs joined by "and" go along. What names a movement by a noun is
    something that is done.

    >>> as_gerund("bend down and take the cup"), as_gerund("a person walks forward and waves")
    ('bending down and taking the cup', 'walking forward and waving')
    >>> as_gerund("slowly sit down"), as_gerund("a left jab"), as_gerund("waving")
    ('slowly sitting down', 'doing a left jab', 'waving')
    """
    text = " ".join(phrase.split()).rstrip(".!")
    third = SUBJECT.match(text)
    if third:
        text = text[third.end() :]
    text = AUXILIARY.sub("", text)
    words = text.split(" ")
    first = next((index for index, word in enumerate(words) if not is_adverb(word)), 0)
    if not third and is_noun(words, first):
        return f"doing {text}"
    verbs, joined = {first}, False
    for index, word in enumerate(words):
        if joined and not is_adverb(word) and bare(word) not in JOINED:
            if is_joined_verb(bare(word), third is not None):
                verbs.add(index)
            joined = False
        joined = joined or (index >= first and (bare(word) in JOINED or word.endswith(",")))
    return " ".join(ing(word, third is not None) if index in verbs else word for index, word in enumerate(words))


def is_noun(words: list[str], first: int) -> bool:
    """Whether a description names its movement: "a left jab", "exhausted walk", "shadow boxing"."""
    word = bare(words[first])
    if word in NOT_VERBS or (re.search(r"[^aeiou][^aeiou]?ed$", word) and word not in {"shed", "wed", "sled"}):
        return True
    following = bare(words[first + 1]) if first + 1 < len(words) else ""
    return following.endswith("ing") and len(following) > 5 and word not in BEFORE_GERUNDS and not word.endswith("ing")


def ing(word: str, third: bool) -> str:
    stem = re.match(r"[\w'-]*", word)[0]
    return gerund(base_of(stem) if third else stem) + word[len(stem) :]


def is_joined_verb(word: str, third: bool) -> bool:
    """Whether a word after an "and" or a comma is another verb, and not one more object or direction."""
    if word in OBJECTS or word.endswith(("ing", "ly", "wards", "ward")):
        return False
    ends = word.endswith("s") and not word.endswith("ss")
    return ends if third else not ends


def is_adverb(word: str) -> bool:
    return bare(word) in ADVERBS or (
        bare(word).endswith("ly") and bare(word) not in {"fly", "rely", "apply", "multiply"}
    )


def bare(word: str) -> str:
    return word.strip(",;:.!?").lower()
