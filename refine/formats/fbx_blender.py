"""GLB to FBX by Blender's own module, as a program of its own: ``BPY_PYTHON fbx_blender.py in.glb out.fbx 30``.

It runs in the Python that has ``bpy`` and is never imported here: that module is under the GPL, wants another NumPy,
and may end the process it is in. The last argument is the frame rate of the motion. The GLB comes at the nearest whole
one, for Blender counts whole frames and reads keys by the whole rate alone.
"""

import sys


def main(source: str, target: str, fps: float) -> None:
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = max(round(fps), 1)
    scene.render.fps_base = 1.0
    bpy.ops.import_scene.gltf(filepath=source, disable_bone_shape=True)
    scene.render.fps_base = scene.render.fps / fps
    frames = [action.frame_range for action in bpy.data.actions]
    scene.frame_start = round(min(start for start, _ in frames))
    scene.frame_end = round(max(end for _, end in frames))
    bpy.ops.export_scene.fbx(
        filepath=target,
        object_types={"ARMATURE", "MESH"},
        add_leaf_bones=False,
        mesh_smooth_type="FACE",
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=True,
        bake_anim_simplify_factor=0.0,
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
