"""Where Blender has the joints: ``BPY_PYTHON blender_joints.py FILE FPS FRAME...`` prints JSON, y up, metres."""

import json
import sys

import bpy


def main(path: str, fps: float, frames: list[int]) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = max(round(fps), 1)
    scene.render.fps_base = scene.render.fps / fps
    importer = bpy.ops.import_scene.gltf if path.endswith(".glb") else bpy.ops.import_scene.fbx
    importer(filepath=path)
    (armature,) = (thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    meshes = [thing for thing in bpy.data.objects if thing.type == "MESH" and thing.find_armature() == armature]
    actions = {action.name: [round(x, 3) for x in action.frame_range] for action in bpy.data.actions}
    first = round(armature.animation_data.action.frame_range[0])
    # Its importer of FBX takes the rate from the file, and then counts its seconds by the whole rate alone.
    step = scene.render.fps_base if path.endswith(".fbx") else 1.0
    joints, low, high = [], [], []
    for frame in frames:
        at = first + frame * step
        scene.frame_set(int(at), subframe=at - int(at))
        place = {bone.name: armature.matrix_world @ bone.head for bone in armature.pose.bones}
        joints.append({name: [x, z, -y] for name, (x, y, z) in place.items()})
        graph = bpy.context.evaluated_depsgraph_get()
        points = [
            thing.matrix_world @ vertex.co
            for mesh in meshes
            for thing in [mesh.evaluated_get(graph)]
            for vertex in thing.data.vertices
        ]
        low.append([min(p[0] for p in points), min(p[2] for p in points), min(-p[1] for p in points)])
        high.append([max(p[0] for p in points), max(p[2] for p in points), max(-p[1] for p in points)])
    rate = scene.render.fps / scene.render.fps_base
    found = {"rate": rate, "joints": joints, "low": low, "high": high, "actions": actions}
    found["materials"] = [material.name for mesh in meshes for material in mesh.data.materials]
    print("FOUND " + json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), [int(frame) for frame in sys.argv[3:]])
