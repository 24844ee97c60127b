"""Where trimesh has the joints of a GLB's first take: ``JUDGES_PYTHON trimesh_joints.py FILE SECONDS...`` prints JSON.

trimesh knows the scene and its transforms, and no animation: its keys are read here, and put into its scene.
"""

import json
import struct
import sys

import numpy as np
import trimesh
from trimesh.transformations import quaternion_matrix, quaternion_slerp

WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def channels(path: str):
    """(node's name, what is moved, times [K], values [K 3 or 4]) of each channel; floats alone, closely packed."""
    with open(path, "rb") as stream:
        raw = stream.read()
    (length,) = struct.unpack_from("<I", raw, 12)
    scene, binary = json.loads(raw[20 : 20 + length]), raw[28 + length :]

    def values(accessor: int) -> np.ndarray:
        about = scene["accessors"][accessor]
        view = scene["bufferViews"][about["bufferView"]]
        start, width = view.get("byteOffset", 0) + about.get("byteOffset", 0), WIDTH[about["type"]]
        assert about["componentType"] == 5126 and "byteStride" not in view
        return np.frombuffer(binary, "<f4", about["count"] * width, start).reshape(-1, width)

    take = scene["animations"][0]
    for channel in take["channels"]:
        sampler, target = take["samplers"][channel["sampler"]], channel["target"]
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        name = scene["nodes"][target["node"]]["name"]
        yield name, target["path"], values(sampler["input"])[:, 0], values(sampler["output"])


def between(path: str, times: np.ndarray, values: np.ndarray, second: float) -> np.ndarray:
    """The value at a time; quaternions are x, y, z, w in files and w, x, y, z in trimesh."""
    after = int(np.clip(np.searchsorted(times, second), 1, len(times) - 1)) if len(times) > 1 else 0
    before = max(after - 1, 0)
    weight = (second - times[before]) / (times[after] - times[before]) if after else 0.0
    if path == "rotation":
        first, last = (values[key][[3, 0, 1, 2]].astype(float) for key in (before, after))
        return quaternion_slerp(first, last, float(np.clip(weight, 0, 1)))
    return values[before] + (values[after] - values[before]) * np.clip(weight, 0, 1)


def main(path: str, seconds: list[float]) -> None:
    scene, moved = trimesh.load(path), list(channels(path))
    parents, joints = scene.graph.transforms.parents, []
    names = [name for name in dict.fromkeys(name for name, *_ in moved)]
    for second in seconds:
        matrices = {name: scene.graph.get(name, parents[name])[0].copy() for name in names}
        for name, what, times, values in moved:
            now = between(what, times, values, second)
            if what == "rotation":
                matrices[name][:3, :3] = quaternion_matrix(now)[:3, :3]
            else:
                assert what == "translation"
                matrices[name][:3, 3] = now
        for name, matrix in matrices.items():
            scene.graph.update(frame_from=parents[name], frame_to=name, matrix=matrix)
        joints.append({name: scene.graph.get(name)[0][:3, 3].tolist() for name in names})
    print(json.dumps({"joints": joints}))


if __name__ == "__main__":
    main(sys.argv[1], [float(second) for second in sys.argv[2:]])
