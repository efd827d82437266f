#!/usr/bin/python3
"""Plots the predicted and actual overlay error: plot_error.py RECORDING error.png"""

import sys

import matplotlib
matplotlib.use("Agg")  # without a display
import matplotlib.pyplot as plt
import numpy as np
import penumbra


def actual_error(recording, pose):
    """Overlay error [px] of a trajectory of one pose; NaN without a true pose at its time."""
    try:
        return penumbra.evaluate(recording.camera, pose, recording.groundtruth).overlay_px.rmse
    except penumbra.Error:
        return np.nan


def errors_of(recording):
    """Time [s], predicted and actual overlay error [px] of each tracked frame."""
    if recording.groundtruth is None:
        raise penumbra.Error(f"{recording.folder}: has no groundtruth.tum; plot another recording")
    tracker = penumbra.Tracker(recording.camera, recording.tags)
    poses = penumbra.Trajectory()
    for frame in recording:
        table = tracker.track(frame.image, frame.time_ns, frame.exposure_s).table
        if table.state == "tracked":
            poses.append(frame.time_ns, table.pose, table.predicted_overlay_px)
    actual = np.array([actual_error(recording, poses[i : i + 1]) for i in range(len(poses))])
    judged = np.isfinite(actual)
    if not judged.any():
        raise penumbra.Error(f"{recording.folder}: no tracked pose has a true pose at its time")
    return 1e-9 * poses.times_ns[judged], poses.predicted_px[judged], actual[judged]


def main(folder, file):
    time_s, predicted, actual = errors_of(penumbra.Recording(folder))
    print(f"{len(actual)} frames, actual {np.sqrt(np.mean(actual**2)):.3f} px, "
          f"predicted {np.sqrt(np.mean(predicted**2)):.3f} px (RMS)")
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.fill_between(time_s, 0, 2 * predicted, color="tab:blue", alpha=0.15, label="2 sigma")
    axes.plot(time_s, predicted, label="predicted (1 sigma)")
    axes.plot(time_s, actual, "o-", color="tab:red", markersize=3, linewidth=0.8, label="actual")
    axes.set(xlabel="time [s]", ylabel="overlay error [px]",
             ylim=(0, 1.2 * np.max([2 * predicted, actual])))  # the curves are below the legend
    axes.set_title("Overlay error of " + penumbra.Recording(folder).folder.name)
    axes.legend(loc="upper center", ncol=3)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: plot_error.py RECORDING error.png")
    try:
        main(*sys.argv[1:])
    except penumbra.Error as error:
        sys.exit(f"plot_error.py: {error}")
