"""evaluate() and Trajectory: the numbers of `penumbra evaluate`."""

import json
import unittest

import numpy as np
import penumbra
from support import TABLETOP, TestCase, run

BAD = (float("nan"), float("inf"), -float("inf"))


def changed(trajectory, **columns):
    """The trajectory with other columns."""
    given = dict(times_ns=trajectory.times_ns, positions=trajectory.positions,
                 quaternions_xyzw=trajectory.quaternions_xyzw,
                 predicted_px=trajectory.predicted_px)
    return penumbra.Trajectory(**(given | columns))


class EvaluateCommand(TestCase):
    def test_has_the_same_errors(self):
        recording = penumbra.Recording(TABLETOP)
        truth = recording.groundtruth
        moved = truth.positions
        index = np.arange(len(truth))
        moved[index, index % 3] += 1e-4 * (index % 11)
        changed(truth, positions=moved).save(self.folder / "estimated.tum")
        expected = json.loads(run("evaluate", "--estimated", self.folder / "estimated.tum",
                                  "--groundtruth", TABLETOP / "groundtruth.tum", "--camera",
                                  TABLETOP / "camera.yaml", "--json"))
        estimated = penumbra.Trajectory.load(self.folder / "estimated.tum")
        errors = penumbra.evaluate(recording.camera, estimated, truth)
        for name in ("frames_judged", "frames_estimated"):
            self.assertEqual(getattr(errors, name), expected[name])
        self.assertEqual((errors.outside_truth, errors.gap_too_long), (0, 0))
        for name in ("translation_mm", "rotation_deg", "overlay_px"):
            for statistic in ("rmse", "median", "p95", "max"):
                found = getattr(getattr(errors, name), statistic)
                self.assertAlmostEqual(found, expected[name][statistic], delta=1e-9 * (1 + found))
        self.assertAlmostEqual(errors.jitter_px, expected["jitter_px"], delta=1e-9)
        self.assertAlmostEqual(errors.translation_mm.max, 1.0, delta=1e-9)
        self.assertEqual(errors.warnings, [])
        # The errors of single frames, from slices.
        frames = [penumbra.evaluate(recording.camera, estimated[i : i + 1], truth).overlay_px.rmse
                  for i in range(len(estimated))]
        rmse = np.sqrt(np.mean(np.square(frames)))
        self.assertAlmostEqual(rmse, errors.overlay_px.rmse, delta=1e-9)


class Trajectories(TestCase):
    def setUp(self):
        super().setUp()
        self.truth = penumbra.Trajectory.load(TABLETOP / "groundtruth.tum")

    def test_have_columns(self):
        truth = self.truth
        count = len(truth)
        self.assertEqual((truth.times_ns.shape, truth.times_ns.dtype), ((count,), np.int64))
        self.assertEqual(truth.positions.shape, (count, 3))
        self.assertEqual(truth.quaternions_xyzw.shape, (count, 4))
        self.assertEqual(truth.matrices.shape, (count, 4, 4))
        self.assertTrue(np.isnan(truth.predicted_px).all())
        time_ns, pose = truth[-1]
        self.assertEqual(time_ns, truth.times_ns[-1])
        self.assert_same_bits(pose.position, truth.positions[-1])
        self.assert_same_bits(pose.matrix, truth.matrices[-1])
        self.assert_same_bits(truth[2:9:3].positions, truth.positions[2:9:3])
        self.assertEqual([t for t, _ in truth], truth.times_ns.tolist())
        with self.assertRaises(IndexError):
            truth[count]
        self.assert_same_bits(changed(truth).matrices, truth.matrices)

    def test_keep_every_bit_in_files(self):
        self.truth.save(self.folder / "poses.tum")
        again = penumbra.Trajectory.load(self.folder / "poses.tum")
        self.assert_same_bits(again.times_ns, self.truth.times_ns)
        self.assert_same_bits(again.positions, self.truth.positions)
        written = np.loadtxt(self.folder / "poses.tum")
        self.assert_same_bits(np.ascontiguousarray(written[:, 4:]), self.truth.quaternions_xyzw)
        self.assert_fails(penumbra.Error, "none.tum", penumbra.Trajectory.load, "none.tum")

    def test_grow(self):
        trajectory = penumbra.Trajectory()
        self.assertEqual((len(trajectory), trajectory.positions.shape), (0, (0, 3)))
        trajectory.append(5, penumbra.Pose([1, 2, 3]))
        trajectory.append(np.int64(6), np.eye(4), predicted_px=0.25)
        np.testing.assert_array_equal(trajectory.times_ns, [5, 6])
        np.testing.assert_array_equal(trajectory.predicted_px, [np.nan, 0.25])
        self.assert_fails(TypeError, "time_ns: is a float", trajectory.append, 7.5, np.eye(4))
        self.assert_fails(TypeError, "pose: is a NoneType", trajectory.append, 7, None)
        self.assertEqual(len(trajectory), 2)

    def test_are_checked(self):
        camera = penumbra.CameraModel.load(TABLETOP / "camera.yaml")
        truth = self.truth

        def fails(text, estimated, **named):
            evaluate = penumbra.evaluate
            self.assert_fails(penumbra.Error, text, evaluate, camera, estimated, truth, **named)

        fails("estimated: holds no pose", penumbra.Trajectory())
        for bad in BAD:
            positions, quaternions = truth.positions, truth.quaternions_xyzw
            positions[3, 1] = quaternions[4, 0] = bad
            fails("estimated[3]: T_table_camera: position", changed(truth, positions=positions))
            turned = changed(truth, quaternions_xyzw=quaternions)
            fails("estimated[4]: T_table_camera: quaternion", turned)
            fails("max_gap_s", truth, max_gap_s=bad)
            fails("time_offset_s", truth, time_offset_s=bad)
        times = truth.times_ns
        times[2] = times[1]
        fails("is not after", changed(truth, times_ns=times))
        fails("no pose that can be compared", truth, time_offset_s=1e6)
        self.assert_fails(penumbra.ArgumentError, "have 1, 2, 1 and 1 rows", penumbra.Trajectory,
                          [1], np.zeros((2, 3)), [[0, 0, 0, 1]])
        self.assert_fails(TypeError, "times_ns: is a float", penumbra.Trajectory,
                          np.array([0.5]), [[0, 0, 0]], [[0, 0, 0, 1]])
        self.assert_fails(TypeError, "times_ns: is a int", penumbra.Trajectory, 5)


if __name__ == "__main__":
    unittest.main()
