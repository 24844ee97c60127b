"""A page read back without the code that wrote it: HTML by the standard library, arrays and joints by NumPy."""

import base64
import json
from html.parser import HTMLParser

import numpy as np

TYPES = {"Float32Array": "<f4", "Int16Array": "<i2", "Uint16Array": "<u2", "Uint32Array": "<u4", "Uint8Array": "u1"}


class Page(HTMLParser):
    """Tags with their attributes, and the text of each script and style."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.raw: list[tuple[str, str]] = []
        self.texts: dict[str, str] = {}
        self._within = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._within = tag
        if tag in ("script", "style"):
            self.raw.append((tag, ""))

    def handle_endtag(self, tag):
        self._within = ""

    def handle_data(self, text):
        if self._within in ("script", "style"):
            self.raw[-1] = (self._within, self.raw[-1][1] + text)
        elif text.strip():
            self.texts.setdefault(self._within, text)

    @property
    def data(self) -> dict:
        """What the page's script reads."""
        [content] = [text for tag, text in self.raw if tag == "script" and text.lstrip().startswith("{")]
        return json.loads(content)


class Arrays:
    def __init__(self, data: dict):
        self._bytes = base64.b64decode(data["bytes"], validate=True)

    def __call__(self, entry: dict) -> np.ndarray:
        count = int(np.prod(entry["shape"]))
        values = np.frombuffer(self._bytes, TYPES[entry["type"]], count, entry["at"])
        assert entry["at"] % 4 == 0
        return values.reshape(entry["shape"]).astype(np.float64)


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """vectors [... 3] rotated by unit quaternions [... 4] (w, x, y, z)."""
    w, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2 * np.cross(axis, vector)
    return vector + w * twice + np.cross(axis, twice)


def multiplied(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(-1, keepdims=True)
    return np.concatenate([w, a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])], -1)


def pose(data: dict, index: int) -> tuple[np.ndarray, np.ndarray]:
    """World joints [T 24 3] and world quaternions [T 24 4] of a motion of the page, by quaternions alone."""
    array, body, motion = Arrays(data), data["body"], data["motions"][index]
    local, rest = array(motion["quaternions"]), array(body["rest"])
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    joints, world = [array(motion["root"])], [local[:, 0]]
    for joint, parent in enumerate(body["parents"][1:], start=1):
        world.append(multiplied(world[parent], local[:, joint]))
        joints.append(joints[parent] + turned(world[parent], rest[joint] - rest[parent]))
    return np.stack(joints, 1), np.stack(world, 1)
