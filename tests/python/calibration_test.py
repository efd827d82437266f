"""calibrate(): the camera file of `penumbra calibrate`; calibrate_corners(); Target."""

import tempfile
import unittest
from pathlib import Path

import numpy as np
import penumbra
from support import SOURCE, TABLETOP, TestCase, first_frame, run
from threads_test import corner_views

NAN = float("nan")


class CalibrateCommand(TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.session = Path(folder.name) / "session"
        run("simulate", "board", "--camera", TABLETOP / "camera.yaml", "--tags",
            TABLETOP / "tags.yaml", "--trajectory", SOURCE / "tests/support/tilted_views.tum",
            "--output", cls.session, "--noise", "1", "--seed", "3")
        cls.images = cls.session / "frames"
        cls.file = cls.session.parent / "expected.yaml"
        cls.output = run("calibrate", cls.images, "--target", TABLETOP / "tags.yaml", "--output",
                         cls.file, "--model", "plumb_bob")
        date = [line for line in cls.file.read_text().splitlines() if "calibrated_on: " in line]
        cls.date = date[0].split(": ")[1].strip("\"'")

    def check(self, images, target):
        result = penumbra.calibrate(images, target, model="plumb_bob")
        result.save(self.folder / "found.yaml", self.date)
        self.assertEqual((self.folder / "found.yaml").read_text(), self.file.read_text())
        self.assertIn(result.verdict, self.output)
        self.assertEqual([view.used for view in result.views], [True] * 7)
        return result

    def test_writes_the_same_file_from_a_folder(self):
        result = self.check(self.images, TABLETOP / "tags.yaml")
        self.assertEqual(result.views[0].name, sorted(self.images.iterdir())[0].name)

    def test_writes_the_same_file_from_files_and_arrays(self):
        frames = list(penumbra.Recording(self.session))
        images = [str(frames[0].file), frames[1].file, *(frame.image for frame in frames[2:])]
        target = penumbra.Target.load(TABLETOP / "tags.yaml")
        result = self.check((image for image in images), target)
        names = [view.name for view in result.views]
        self.assertEqual(names[:3], [frames[0].file.name, frames[1].file.name, "images[2]"])

    def test_explains_what_is_wrong_with_images(self):
        fails, calibrate = self.assert_fails, penumbra.calibrate
        target = penumbra.Target.load(TABLETOP / "tags.yaml")
        fails(penumbra.Error, "is not a folder", calibrate, self.folder / "none", target)
        fails(penumbra.Error, "holds no images", calibrate, self.folder, target)
        fails(penumbra.Error, "none.yaml", calibrate, self.images, "none.yaml")
        fails(penumbra.Error, "no images", calibrate, [], target)
        fails(penumbra.Error, "none of", calibrate, [np.zeros((480, 640), np.uint8)] * 3, target)
        fails(penumbra.ArgumentError, "is a single image", calibrate, first_frame().image, target)
        fails(penumbra.ArgumentError, "model: 'x'", calibrate, self.images, target, model="x")
        fails(penumbra.Error, "max_views", calibrate, self.images, target, max_views=0)
        fails(TypeError, "float64", calibrate, [np.zeros((480, 640))], target)
        (self.folder / "broken.png").write_bytes(b"\x89PNG no image")
        fails(penumbra.Error, "broken.png", calibrate, self.folder, target)


class Calibrators(TestCase):
    def test_are_empty_after_an_error(self):
        calibrator = penumbra.Calibrator(penumbra.Target.chessboard(9, 6, 0.03))
        grey = np.full((48, 64), 128, np.uint8)
        calibrator.add("grey", grey)
        self.assert_fails(penumbra.Error, "one size", calibrator.add, "narrow", grey[:, :48])
        self.assert_fails(penumbra.Error, "none of", calibrator.solve)
        self.assert_fails(penumbra.Error, "no images", calibrator.solve)


class Corners(TestCase):
    def setUp(self):
        super().setUp()
        self.camera = penumbra.CameraModel.load(TABLETOP / "camera.yaml")
        self.points, self.views = corner_views(self.camera)

    def test_give_the_camera(self):
        random = np.random.default_rng(5)
        views = [view + random.normal(0, 0.05, view.shape) for view in self.views]
        views = [np.clip(view, 0, [639, 479]) for view in views]
        result = penumbra.calibrate_corners(640, 480, self.points, views, model="plumb_bob")
        self.assertEqual(result.parameter_names, "fx fy cx cy k1 k2 p1 p2 k3".split())
        self.assertEqual(result.covariance.shape, (9, 9))
        sigma = np.sqrt(np.diag(result.covariance))
        for name, s in zip(("fx", "fy", "cx", "cy"), sigma):
            error = getattr(result.camera, name) - getattr(self.camera, name)
            self.assertLess(abs(error), 4 * s, name)
            self.assertLess(s, 2.0, name)
        self.assertAlmostEqual(result.rms_px, 0.05 * np.sqrt(2), delta=0.015)
        self.assertEqual(len(result.views), 14)
        self.assertGreaterEqual(result.projection_largest_px, result.projection_mean_px)
        self.assertIn(result.grade, ("good", "usable", "poor"))
        self.assertIsInstance(result.advice, list)
        self.assertEqual(result.views[2].name, "views[2]")

    def test_are_checked(self):
        def fails(kind, text, width=640, points=self.points, views=self.views):
            self.assert_fails(kind, text, penumbra.calibrate_corners, width, 480, points, views)

        fails(penumbra.Error, "too few", views=self.views[:2])
        fails(penumbra.Error, "width", width=0)
        fails(penumbra.ArgumentError, "views[0]: has 53 rows; give one for each of the 54 points",
              views=[self.views[0][:-1], *self.views[1:]])
        fails(penumbra.ArgumentError, "views[0]: has shape", views=[np.zeros((54, 3))] * 3)
        fails(TypeError, "views: is a int", views=5)
        half = self.views[0].copy()
        half[3] = [10.0, NAN]
        fails(penumbra.Error, "outside the image", views=[half, *self.views[1:]])
        points = self.points.copy()
        points[5, 0] = NAN
        fails(penumbra.Error, "points[5]", points=points)
        fails(penumbra.ArgumentError, "points: has shape", points=self.points[:, :2])

    def test_targets_are_checked(self):
        target = penumbra.Target
        self.assertEqual(target.chessboard(9, 6, 0.03).points.shape, (54, 3))
        self.assertNotEqual(target.chessboard(9, 6, 0.03).description, "")
        self.assert_fails(penumbra.Error, "at least 3 x 3", target.chessboard, 2, 6, 0.03)
        for bad in (NAN, 0.0, -1.0):
            with self.assertRaises(penumbra.Error):
                target.chessboard(9, 6, bad)


if __name__ == "__main__":
    unittest.main()
