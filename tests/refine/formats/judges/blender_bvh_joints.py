"""Where Blender has a BVH's joints: ``BPY_PYTHON blender_bvh_joints.py FILE FRAME...`` prints JSON, y up, metres."""

import json
import sys

import bpy


def main(path: str, frames: list[int]) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_anim.bvh(filepath=path, axis_forward="-Z", axis_up="Y", rotate_mode="NATIVE", global_scale=0.01)
    (armature,) = (thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    first, found = round(armature.animation_data.action.frame_range[0]), []
    for frame in frames:
        bpy.context.scene.frame_set(first + frame)
        place = {bone.name: armature.matrix_world @ bone.head for bone in armature.pose.bones}
        found.append({name: [x, z, -y] for name, (x, y, z) in place.items()})
    print("FOUND " + json.dumps({"joints": found}))


if __name__ == "__main__":
    main(sys.argv[1], [int(frame) for frame in sys.argv[2:]])
