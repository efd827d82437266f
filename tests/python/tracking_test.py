"""Tracker: the poses of `penumbra replay`, arrays without copies, errors."""

import copy
import gc
import pickle
import sys
import tracemalloc
import unittest

import numpy as np
import penumbra
from support import (RECORDINGS, TABLETOP, TestCase, first_frame, run, shared_recording,
                     tabletop_tracker)


class PosesOfReplay(TestCase):
    def check(self, folder, mode, frames, at_least=5):
        scene = self.folder / "empty.json"
        scene.write_text('{"objects": []}')
        poses = self.folder / "poses.tum"
        run("replay", folder, "--frames", f"0:{frames}", "--no-window", "--tracking", mode,
            "--scene", scene, "--poses", poses)
        recording = penumbra.Recording(folder)
        tracker = penumbra.Tracker(recording.camera, recording.tags, mode=mode)
        found = penumbra.Trajectory()
        self.notices = []
        for frame in recording[:frames]:
            result = tracker.track(frame.image, frame.time_ns, frame.exposure_s)
            self.notices += result.notices
            table = result.table
            if table.state == "tracked":
                found.append(frame.time_ns, table.pose)
        # The numbers of the file; load() would normalise the quaternions again.
        expected = np.loadtxt(poses)
        self.assertGreaterEqual(len(expected), at_least)
        self.assert_same_bits(found.times_ns, np.rint(1e9 * expected[:, 0]).astype(np.int64))
        self.assert_same_bits(found.positions, np.ascontiguousarray(expected[:, 1:4]))
        self.assert_same_bits(found.quaternions_xyzw, np.ascontiguousarray(expected[:, 4:8]))
        found.save(self.folder / "found.tum")
        lines = [file.read_text().splitlines() for file in (poses, self.folder / "found.tum")]
        lines = [[line for line in part if not line.startswith("#")] for part in lines]
        self.assertEqual(lines[1], lines[0])

    def test_of_bundled_recordings_in_every_mode(self):
        for name, mode, frames in [
            ("tabletop", "auto", 20),
            ("tabletop", "fast", 8),
            ("tabletop", "accurate", 8),
            ("tabletop", "detect", 8),
            ("corner", "auto", 8),
        ]:
            with self.subTest(recording=name, mode=mode):
                self.check(RECORDINGS / name, mode, frames)

    def test_of_shared_recordings_in_every_mode(self):
        for name, mode in [("shake", "auto"), ("reentry", "fast"), ("grazing", "accurate"),
                           ("still", "detect")]:
            with self.subTest(recording=name, mode=mode):
                self.check(shared_recording(name), mode, 30 if name == "reentry" else 12)

    def test_of_recordings_with_systematic_errors(self):
        for name in ["bent", "rolling", "lens"]:
            with self.subTest(recording=name):
                self.check(shared_recording(name), "auto", 30)
                self.assertTrue(self.notices)


class TrackedFrames(TestCase):
    def test_have_matrix_and_pose_of_same_bits(self):
        frame = first_frame()
        table = tabletop_tracker().track(frame.image, frame.time_ns).table
        T = table.T_table_camera
        self.assertEqual((T.shape, T.dtype), ((4, 4), np.float64))
        self.assert_same_bits(T, table.pose.matrix)
        self.assert_same_bits(np.ascontiguousarray(T[:3, 3]), table.pose.position)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
        again = penumbra.Pose.from_matrix(T)
        np.testing.assert_allclose(again.quaternion_xyzw, table.pose.quaternion_xyzw, atol=1e-15)

    def test_have_uncertainty_and_tags(self):
        frame = first_frame()
        result = tabletop_tracker().track(frame.image, frame.time_ns)
        table = result.table
        self.assertEqual((result.time_ns, result.groups), (frame.time_ns, {}))
        self.assertEqual((table.state, table.reason, table.has_pose), ("tracked", "", True))
        self.assertEqual(table.covariance.shape, (6, 6))
        self.assert_same_bits(table.covariance, np.ascontiguousarray(table.covariance.T))
        self.assertTrue((np.linalg.eigvalsh(table.covariance) > 0).all())
        self.assertGreaterEqual(table.tags_used, 4)
        self.assertTrue(0 < table.predicted_overlay_px < 2)
        self.assertTrue(0 < table.reprojection_rms_px < 2)
        self.assertEqual((table.tags_rejected, table.age_s), ([], 0.0))

    def test_are_lost_on_a_black_image(self):
        table = tabletop_tracker().track(np.zeros((480, 640), np.uint8), 0).table
        self.assertEqual((table.state, table.has_pose), ("lost", False))
        self.assertNotEqual(table.reason, "")
        self.assertTrue(np.isnan(table.T_table_camera[:3]).all())
        self.assertTrue(np.isnan(table.pose.position).all())
        self.assertTrue(np.isnan(table.pose.quaternion_xyzw).all())
        self.assertTrue(np.isnan(table.covariance).all())
        self.assertTrue(np.isnan(table.predicted_overlay_px))
        self.assert_fails(penumbra.Error, "pose: is not a number",
                          penumbra.Trajectory().append, 0, table.pose)

    def test_name_rejected_tags(self):
        recording = penumbra.Recording(TABLETOP)
        tags = recording.tags.tags
        moved = np.array(tags[0].T_table_tag)
        moved[0, 3] += 0.03
        tags[0] = penumbra.Tag(tags[0].id, tags[0].size_m, moved)
        tracker = penumbra.Tracker(recording.camera, penumbra.TagMap(tags))
        for frame in recording[:5]:
            table = tracker.track(frame.image, frame.time_ns).table
        rejected = [(tag.id, tag.reason) for tag in table.tags_rejected]
        self.assertEqual(rejected, [(tags[0].id, "tags_left_out")])

    def test_have_groups_by_name(self):
        recording = penumbra.Recording(RECORDINGS / "corner")
        tags = [
            penumbra.Tag(tag.id, tag.size_m, tag.pose, tag.family,
                         "wall" if tag.id >= 30 else "table")
            for tag in recording.tags.tags
        ]
        tracker = penumbra.Tracker(recording.camera, penumbra.TagMap(tags))
        for frame in recording[:3]:
            result = tracker.track(frame.image, frame.time_ns)
        self.assertEqual(list(result.groups), ["wall"])
        wall = result.groups["wall"]
        self.assertEqual((wall.name, wall.has_pose), ("wall", True))
        np.testing.assert_allclose(wall.T_table_group[:3, 3], 0.0, atol=2e-3)
        self.assertEqual(wall.T_group_middle.shape, (4, 4))
        self.assert_same_bits(wall.pose.matrix, wall.T_table_group)
        del tracker, result
        gc.collect()
        self.assertEqual(wall.covariance.shape, (6, 6))  # keeps its frame alive
        table_only = penumbra.Tracker(recording.camera, penumbra.TagMap(tags), groups=[])
        self.assertEqual(table_only.track(recording[0].image, 0).groups, {})


class Images(TestCase):
    def setUp(self):
        super().setUp()
        self.frame = first_frame()
        self.grey = np.array(self.frame.image)
        self.expected = self.pose_of(self.grey)

    def pose_of(self, image, **named):
        table = tabletop_tracker().track(image, 0, **named).table
        self.assertEqual(table.state, "tracked")
        return np.concatenate([table.pose.position, table.pose.quaternion_xyzw])

    def padded(self, image, extra):
        """The image as a slice of a wider array, whose rows are farther apart."""
        wide = np.full((image.shape[0], image.shape[1] + extra, *image.shape[2:]), 77, np.uint8)
        wide[:, : image.shape[1]] = image
        return wide[:, : image.shape[1]]

    def test_of_every_format_give_the_same_pose(self):
        rgb = np.dstack([self.grey] * 3)
        yuyv = np.dstack([self.grey, np.full_like(self.grey, 128)])
        for image, format in [
            (self.grey, None),
            (self.grey, "grey8"),
            (self.grey[:, :, np.newaxis], "grey8"),
            (rgb, None),
            (rgb, "rgb24"),
            (yuyv, "yuyv"),
            (yuyv.reshape(480, 1280), "yuyv"),
            (self.grey, "nv12"),
            (self.grey, "yuv420p"),
            (self.grey, "yuv422p"),
            (self.grey, "yuv444p"),
        ]:
            with self.subTest(format=format, shape=image.shape):
                self.assert_same_bits(self.pose_of(image, format=format), self.expected)
                padded = self.padded(image, 10)
                self.assertFalse(padded.flags.c_contiguous)
                self.assert_same_bits(self.pose_of(padded, format=format), self.expected)

    def test_are_read_without_a_copy(self):
        images = {
            "grey": self.grey,
            "slice": self.padded(self.grey, 10),
            "every second row": np.repeat(self.grey, 2, axis=0)[::2],
            "rgb": np.dstack([self.grey] * 3),
            "read-only": self.frame.image,
        }
        trackers = {name: tabletop_tracker() for name in images}
        tracemalloc.start()
        self.addCleanup(tracemalloc.stop)

        def allocated_by(function):
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            function()
            return tracemalloc.get_traced_memory()[1] - before

        # numpy reports its allocations, so that a copy would be seen.
        self.assertGreater(allocated_by(lambda: images["slice"].copy()), self.grey.nbytes)
        for name, image in images.items():
            with self.subTest(name):
                used = allocated_by(lambda: trackers[name].track(image, 0))
                self.assertLess(used, 0.05 * self.grey.nbytes)

    def test_are_not_kept(self):
        expected, found = tabletop_tracker(), tabletop_tracker(search_thread=True)
        lazy = tabletop_tracker(search="when_done")
        for index, frame in enumerate(penumbra.Recording(TABLETOP)[:12]):
            image = np.array(frame.image)
            if 3 <= index < 6:
                image[:] = 0  # the tags are lost and searched for
            clean = expected.track(image.copy(), frame.time_ns).table
            for tracker in (found, lazy):
                copy = image.copy()
                references = sys.getrefcount(copy)
                table = tracker.track(copy, frame.time_ns).table
                self.assertEqual(sys.getrefcount(copy), references)
                copy[:] = np.random.default_rng(index).integers(0, 256, copy.shape)
                del copy
                gc.collect()
                if tracker is found:
                    self.assertEqual(table.state, clean.state)
                    self.assert_same_bits(table.T_table_camera, clean.T_table_camera)

    def test_that_do_not_fit_are_refused(self):
        tracker = tabletop_tracker()
        track = tracker.track
        rgb = np.dstack([self.grey] * 3)
        for kind, text, image in [
            (TypeError, "image: is a list; give a numpy array of uint8", [[0, 1]]),
            (TypeError, "image: is a NoneType", None),
            (TypeError, "image: is a bytes", bytes(640 * 480)),
            (TypeError, "float64 array of shape (480, 640); give uint8", self.grey / 255),
            (TypeError, "int8 array", self.grey.astype(np.int8)),
            (TypeError, "uint16 array", self.grey.astype(np.uint16)),
            (TypeError, "bool array", self.grey > 9),
            (TypeError, "object array", self.grey.astype(object)),
            (penumbra.ArgumentError, "shape (307200,); give (height, width)", self.grey.ravel()),
            (penumbra.ArgumentError, "shape ()", np.array(7, np.uint8)),
            (penumbra.ArgumentError, "shape (480, 640, 4)", np.zeros((480, 640, 4), np.uint8)),
            (penumbra.ArgumentError, "shape (1, 480, 640)", self.grey[np.newaxis]),
            (penumbra.ArgumentError, "no pixels", np.zeros((0, 640), np.uint8)),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", self.grey[:, ::2]),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", self.grey[::-1]),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", self.grey[:, ::-1]),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", self.grey.T),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", rgb[:, :, ::-1]),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)", np.asfortranarray(rgb)),
            (penumbra.ArgumentError, "np.ascontiguousarray(image)",
             np.broadcast_to(self.grey[0], (480, 640))),
            (penumbra.Error, "image: is 640 x 240 px", self.grey[:240]),
            (penumbra.Error, "image: is 320 x 480 px", self.grey[:, :320]),
        ]:
            with self.subTest(text):
                self.assert_fails(kind, text, track, image, 0)
        fails = self.assert_fails
        fails(penumbra.ArgumentError, "'bgr24' is not known; give 'grey8', 'rgb24'", track,
              self.grey, 0, format="bgr24")
        references = sys.getrefcount(rgb)
        fails(penumbra.ArgumentError, "for the format 'nv12'", track, rgb, 0, format="nv12")
        self.assertEqual(sys.getrefcount(rgb), references)
        fails(penumbra.ArgumentError, "for the format 'rgb24'", track, self.grey, 0, format="rgb24")
        # The tracker ignores what it refuses.
        table = track(self.grey, 0).table
        self.assert_same_bits(table.pose.position, self.expected[:3])


class Arguments(TestCase):
    def test_times_are_integers_that_increase(self):
        tracker, image = tabletop_tracker(), first_frame().image
        fails = self.assert_fails
        for bad in (0.5, 1e9, np.float64(3), "7", None):
            fails(TypeError, "time_ns: is a", tracker.track, image, bad)
        for bad in (2**63, -(2**70)):
            fails(penumbra.ArgumentError, "is out of range", tracker.track, image, bad)
        fails(penumbra.Error, "is out of range", tracker.track, image, 2**62)
        self.assertEqual(tracker.track(image, np.int64(5)).time_ns, 5)
        fails(penumbra.Error, "5 ns is not after 5 ns", tracker.track, image, 5)
        fails(penumbra.Error, "4 ns is not after 5 ns", tracker.track, image, 4)
        for bad in (0.0, -1.0, float("nan"), float("inf")):
            fails(penumbra.Error, "exposure_s", tracker.track, image, 6, bad)
        self.assertEqual(tracker.track(image, np.uint32(6), 0.005).table.state, "tracked")

    def test_options_are_checked(self):
        fails = self.assert_fails
        for bad in (-1.0, float("nan"), float("inf")):
            fails(penumbra.Error, "pose_budget_px", tabletop_tracker, pose_budget_px=bad)
            fails(penumbra.Error, "hold_s", tabletop_tracker, hold_s=bad)
        fails(penumbra.ArgumentError, "mode: 'automatic' is not known; give 'auto', 'fast', "
              "'accurate' or 'detect'", tabletop_tracker, mode="automatic")
        fails(penumbra.ArgumentError, "search: 'now'", tabletop_tracker, search="now")
        fails(TypeError, "groups: is a str", tabletop_tracker, groups="wall")
        fails(penumbra.Error, "'wal'", tabletop_tracker, groups=["wal"])

    def test_tag_maps_are_checked(self):
        good = penumbra.Tag(1, 0.04, np.eye(4))
        nan = float("nan")
        fails = self.assert_fails
        fails(penumbra.Error, "empty", penumbra.TagMap, [])
        fails(penumbra.Error, "twice", penumbra.TagMap, [good, good])
        for bad in (0.0, -1.0, nan, float("inf")):
            fails(penumbra.Error, "size_m", penumbra.TagMap, [penumbra.Tag(1, bad, np.eye(4))])
        fails(penumbra.Error, "not known", penumbra.TagMap,
              [penumbra.Tag(1, 0.04, np.eye(4), "tag36h12")])
        lost = np.eye(4)
        lost[0, 3] = nan
        fails(penumbra.Error, "position", penumbra.TagMap, [penumbra.Tag(1, 0.04, lost)])
        fails(penumbra.ArgumentError, "curvature: has shape (2,); give 3 numbers", penumbra.Tag,
              1, 0.04, np.eye(4), curvature=(0, 0))
        fails(penumbra.Error, "none.yaml", penumbra.TagMap.load, self.folder / "none.yaml")

    def test_tag_maps_round_trip(self):
        tags = penumbra.TagMap.load(RECORDINGS / "corner" / "tags.yaml")
        tags.save(self.folder / "tags.yaml")
        loaded = penumbra.TagMap.load(str(self.folder / "tags.yaml"))
        for again in (loaded, pickle.loads(pickle.dumps(tags)), copy.deepcopy(tags)):
            self.assertEqual(len(again), len(tags))
            for a, b in zip(again.tags, tags.tags):
                for name in ("id", "family", "size_m", "group"):
                    self.assertEqual(getattr(a, name), getattr(b, name))
                self.assertEqual(a.pose, b.pose)
                self.assert_same_bits(a.curvature, b.curvature)

    def test_set_tag_map_takes_only_the_same_tags(self):
        recording = penumbra.Recording(TABLETOP)
        tracker = penumbra.Tracker(recording.camera, recording.tags)
        tracker.track(recording[0].image, recording[0].time_ns)
        tags = recording.tags.tags
        self.assert_fails(penumbra.Error, "set_tag_map", tracker.set_tag_map,
                          penumbra.TagMap(tags[1:]))
        moved = []
        for tag in tags:
            T = np.array(tag.T_table_tag)
            T[0, 3] += 0.1
            moved.append(penumbra.Tag(tag.id, tag.size_m, T, tag.family))
        tracker.set_tag_map(penumbra.TagMap(moved))
        before = tabletop_tracker().track(recording[1].image, 0).table
        after = tracker.track(recording[1].image, recording[1].time_ns).table
        shift = after.T_table_camera[:3, 3] - before.T_table_camera[:3, 3]
        np.testing.assert_allclose(shift, [0.1, 0, 0], atol=2e-3)


if __name__ == "__main__":
    unittest.main()
