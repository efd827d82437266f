"""Makes a recording by `penumbra simulate`, and the bundled scene with its helicopter in the air."""
import json
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
FIRST_POSE = 45  # 1.5 s from the start


def make(program, folder, frames, size=(1280, 720)):
    """Simulates the bundled motion over the bundled tags without noise. Returns the recording's folder and the scene's file."""
    bundled = ROOT / "recordings" / "tabletop"
    width, height = size
    scale = width / 1280  # another size has the same horizontal field of view
    (folder / "camera.yaml").write_text(
        f"image_width: {width}\nimage_height: {height}\ncamera_matrix: {{rows: 3, cols: 3, data: [{1063.4 * scale:g}, 0, {644.6 * scale:g}, 0, "
        f"{1060.8 * scale:g}, {355.2 * height / 720:g}, 0, 0, 1]}}\ndistortion_model: plumb_bob\ndistortion_coefficients: {{rows: 1, cols: 5, "
        "data: [-0.215, 0.062, 0.0008, -0.0006, -0.004]}\n")
    poses = [line for line in (bundled / "groundtruth.tum").read_text().splitlines() if not line.startswith("#")]
    (folder / "poses.tum").write_text("\n".join(poses[FIRST_POSE:FIRST_POSE + frames]) + "\n")
    subprocess.run([program, "simulate", "board", "--camera", folder / "camera.yaml", "--tags", bundled / "tags.yaml", "--trajectory",
                    folder / "poses.tum", "--output", folder / "recording"], check=True, capture_output=True)
    scene = json.loads((ROOT / "scenes" / "default.json").read_text())
    for thing in scene["objects"]:
        thing["model"] = str(ROOT / "scenes" / thing["model"])
    for key in scene["objects"][0]["animation"]["keyframes"]:
        key["time_s"] -= 1.5
    scene["objects"][0]["animation"]["keyframes"] = [key for key in scene["objects"][0]["animation"]["keyframes"] if key["time_s"] >= 0]
    scene["objects"][0]["animation"]["loop"] = False
    scene.pop("$schema")
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder / "recording", folder / "scene.json"
