"""OpenAI's chat protocol, spoken to a server that may be down, slow, busy, or something else altogether.

Nothing else in Refine uses a network, and this only for the address that somebody gives.
"""

import http.client
import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any
from urllib.parse import urlsplit

from refine.formats.untrusted import parse_json
from renderers.checks import UserError

MAX_REPLY = 1 << 20  # bytes
MAX_WAIT = 60.0  # seconds that a server may ask to be left alone
PASSING = (408, 409, 425, 429)  # what may be over at the next try, as all from 500 on
SHOWN = 200  # characters of what a server says

Sleep = Callable[[float], None]
Message = dict[str, str]  # "role" and "content"


@dataclass(frozen=True)
class Endpoint:
    """Where a language model is asked, and how patiently."""

    url: str
    """Up to and without /chat/completions, such as "http://localhost:8000/v1"."""
    model: str | None = None
    """Its name; none takes the one that the server has."""
    timeout: float = 30.0
    """Seconds for one answer."""
    tries: int = 4
    """For each phrase, with waits of 1, 2, 4 seconds and so on between them."""

    def __post_init__(self):
        problem = _problem(self.url)
        if problem:
            raise UserError("--llm-url", problem, "give an address such as http://localhost:8000/v1")
        if not 0 < self.timeout <= 3600:
            raise UserError("--llm-timeout", f"expected more than 0 and at most 3600 seconds, got {self.timeout:g}")
        if not 1 <= self.tries <= 10:
            raise UserError("tries", f"expected 1 to 10, got {self.tries}")
        object.__setattr__(self, "url", self.url.rstrip("/"))


class NoAnswer(Exception):
    """All tries failed; the text says how the last one did."""


class Silence(NoAnswer):
    """Nothing came back: asking something else would not help."""


class _Passing(Exception):
    """A try failed in a way that the next one may not."""

    def __init__(self, reason: str, wait: float | None = None, kind: type[NoAnswer] = NoAnswer):
        super().__init__(reason)
        self.wait, self.kind = wait, kind  # seconds, where the server says; what it is when all tries fail so


class _Unsupported(Exception):
    """The server refuses an option of the question."""


class Server:
    """Speaks the protocol, and tries again.

    Raises:
        UserError: the key is none.
    """

    def __init__(self, endpoint: Endpoint, key: str | None, sleep: Sleep):
        self.endpoint, self.key, self.sleep = endpoint, (key or "").strip(), sleep
        if not (self.key.isascii() and self.key.isprintable()):
            raise UserError("OPENAI_API_KEY", "holds characters that no key has", "set it again")
        self.options = {"temperature": 0, "max_tokens": 1024}
        self.opener = urllib.request.build_opener(_NoRedirection)

    def only_model(self) -> str:
        """The name of the model, of a server that has one.

        Raises:
            NoAnswer: it cannot be asked.
            UserError: it has several, or does not say.
        """
        remedy, names = "name one with --llm-model", []
        with suppress(KeyError, TypeError):
            names = [str(each["id"]) for each in self._trying(lambda: self._exchange("/models"))["data"]]
        if len(names) != 1:
            shown = f"has {', '.join(names[:5])}{' and more' if len(names) > 5 else ''}" if names else "names no model"
            raise UserError(self.endpoint.url, shown, remedy)
        return names[0]

    def answer(self, model: str, messages: Sequence[Message], usable: Callable[[str], bool]) -> str:
        """What the model answers, once that is usable.

        Raises:
            NoAnswer: after all tries.
            UserError: trying again would not help.
        """
        return self._trying(lambda: self._completion(model, messages, usable))

    def _completion(self, model: str, messages: Sequence[Message], usable: Callable[[str], bool]) -> str:
        try:
            reply = self._exchange("/chat/completions", {"model": model, "messages": messages, **self.options})
        except _Unsupported:  # some models have options of their own
            return self._completion(model, messages, usable)
        try:
            text = reply["choices"][0]["message"]["content"]
        except (KeyError, IndexError, TypeError):
            text = None
        if not isinstance(text, str):
            raise _Passing("answers, but not in the chat protocol")
        if not usable(text):
            raise _Passing("an answer that cannot be used")
        return text

    def _trying(self, attempt: Callable[[], Any]) -> Any:
        for number in range(self.endpoint.tries):
            try:
                return attempt()
            except _Passing as error:
                wait = 2.0**number if error.wait is None else error.wait
                if wait > MAX_WAIT:
                    raise NoAnswer(f"{error}, and asks to wait for {wait:.0f} s") from None
                if number + 1 == self.endpoint.tries:
                    raise error.kind(str(error)) from None
            self.sleep(wait)
        raise AssertionError("at least one try")

    def _exchange(self, path: str, content: dict[str, Any] | None = None) -> Any:
        """The JSON values that the server replies with, to a question or to none.

        Raises:
            _Passing: no reply in time, none that is JSON, or an error that may be over soon.
            _Unsupported: an option is refused, and was taken out of ``options``.
            UserError: an error that stays.
        """
        headers = {"Accept": "application/json", "User-Agent": "refine-motion"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        data = None
        if content is not None:
            data, headers["Content-Type"] = json.dumps(content).encode(), "application/json"
        request = urllib.request.Request(self.endpoint.url + path, data, headers)
        until = time.monotonic() + self.endpoint.timeout
        try:
            with self.opener.open(request, timeout=self.endpoint.timeout) as response:
                reply = _bounded(response, until)
        except urllib.error.HTTPError as error:
            with error:
                self._refused(error, until)
        except (OSError, http.client.HTTPException, UnicodeError) as error:  # the last of a name that no host can have
            cause = getattr(error, "reason", error)
            reason = f"({_short(getattr(cause, 'strerror', '') or str(cause))})"
            why = f"in {self.endpoint.timeout:g} s" if isinstance(cause, TimeoutError) else reason
            raise _Passing(f"no answer {why}", kind=Silence) from None
        try:
            return parse_json(self.endpoint.url, reply)
        except UserError:
            raise _Passing("answers, but not in JSON") from None

    def _refused(self, error: urllib.error.HTTPError, until: float) -> None:
        """Raise what a status other than success stands for."""
        code, url = error.code, self.endpoint.url
        if 300 <= code < 400:
            raise UserError(url, "sends us elsewhere, which is not followed", "give the address where the model is")
        if code in (401, 403):
            had = "refuses the key in OPENAI_API_KEY" if self.key else "asks for a key, and OPENAI_API_KEY is not set"
            raise UserError(url, f"{had} ({code})", "set OPENAI_API_KEY to a key of this server")
        if code in PASSING or code >= 500:
            raise _Passing(f"error {code}", _wait(error.headers.get("Retry-After")))
        said = ""
        with suppress(OSError, http.client.HTTPException, _Passing):
            said = _bounded(error, until).decode("utf-8", "replace")
        if code in (400, 422) and (refused := [name for name in self.options if name in said]):
            del self.options[refused[0]]
            raise _Unsupported
        with suppress(UserError, KeyError, TypeError):
            said = str(parse_json(url, said.encode())["error"]["message"])
        said = _short(said.replace(self.key, "...") if self.key else said)
        problem = f"refuses the question with error {code}{f' ({said})' if said else ''}"
        raise UserError(url, problem, "check the address and --llm-model")


class _NoRedirection(urllib.request.HTTPRedirectHandler):
    """The key is for one server: a redirection is an error."""

    def redirect_request(self, *_arguments: Any) -> None:
        return None


def _bounded(response: Any, until: float) -> bytes:
    """All that is sent, unless it is too much or takes too long."""
    found = bytearray()
    while block := response.read1(1 << 16):
        found += block
        if len(found) > MAX_REPLY:
            raise _Passing(f"an answer of more than {MAX_REPLY} bytes")
        if time.monotonic() > until:
            raise TimeoutError
    return bytes(found)


def _wait(after: str | None) -> float | None:
    """Seconds that a Retry-After asks for, which is a number of them or a date."""
    if not after:
        return None
    with suppress(ValueError, OverflowError):
        return max(0.0, float(int(after)))
    with suppress(ValueError, TypeError, OverflowError):
        when = parsedate_to_datetime(after)
        return max(0.0, (when.replace(tzinfo=when.tzinfo or UTC) - datetime.now(UTC)).total_seconds())
    return None


def _problem(url: str) -> str:
    """What is wrong with an address; nothing if it can be used."""
    try:
        parts = urlsplit(url)
        named, _ = parts.hostname, parts.port
    except ValueError:
        return "is no address"
    if parts.scheme not in ("http", "https") or not named or not url.isascii() or not url.isprintable() or " " in url:
        return "is no address of the web"
    if parts.username is not None or parts.password is not None or parts.query or parts.fragment:
        return "has a name, a password, a query or a fragment, which is not sent"
    return ""


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= SHOWN else f"{line[:SHOWN]}..."
