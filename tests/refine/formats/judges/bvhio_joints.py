"""Where bvhio has a BVH's joints: ``JUDGES_PYTHON bvhio_joints.py FILE FRAME...`` prints JSON, in the file's unit."""

import json
import sys

import bvhio


def main(path: str, frames: list[int]) -> None:
    root = bvhio.readAsHierarchy(path)
    joints = []
    for frame in frames:
        root.loadPose(frame)
        joints.append({joint.Name: list(joint.PositionWorld) for joint, *_ in root.layout()})
    print(json.dumps({"joints": joints, "frames": bvhio.readAsBvh(path).FrameCount}))


if __name__ == "__main__":
    main(sys.argv[1], [int(frame) for frame in sys.argv[2:]])
