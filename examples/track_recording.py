#!/usr/bin/python3
"""Tracks the tags of a recording and writes the camera's poses as a TUM file:

    track_recording.py RECORDING poses.tum

RECORDING is a folder with camera.yaml, tags.yaml, timestamps.csv and frames/. It prints the state
of each frame, and the errors if the recording has true poses.
"""

import sys

import penumbra


def main(folder, file):
    recording = penumbra.Recording(folder)
    for notice in recording.notices:
        print(notice, file=sys.stderr)
    tracker = penumbra.Tracker(recording.camera, recording.tags)

    poses = penumbra.Trajectory()
    for frame in recording:
        # An image of a camera: a uint8 array, (height, width) in grey or (height, width, 3) in RGB;
        # of OpenCV, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).
        result = tracker.track(frame.image, frame.time_ns, frame.exposure_s)
        for notice in result.notices:
            print(notice, file=sys.stderr)
        table = result.table
        if table.state == "tracked":
            poses.append(frame.time_ns, table.pose, table.predicted_overlay_px)
            x, y, z = table.T_table_camera[:3, 3]
            print(f"frame {frame.number}: camera at {x:.4f} {y:.4f} {z:.4f} m, "
                  f"{table.tags_used} tags, overlay error {table.predicted_overlay_px:.2f} px")
        else:
            print(f"frame {frame.number}: {table.state}: {table.reason}")
        for name, group in result.groups.items():
            if group.has_pose:
                print(f"  {name} at", *group.T_table_group[:3, 3].round(4), "m")
    poses.save(file)

    if recording.groundtruth:
        errors = penumbra.evaluate(recording.camera, poses, recording.groundtruth)
        print(f"{errors.frames_judged} frames: translation {errors.translation_mm.rmse:.3f} mm, "
              f"rotation {errors.rotation_deg.rmse:.4f} deg, "
              f"overlay {errors.overlay_px.rmse:.3f} px")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: track_recording.py RECORDING poses.tum")
    try:
        main(*sys.argv[1:])
    except penumbra.Error as error:
        sys.exit(f"track_recording.py: {error}")
