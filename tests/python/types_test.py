"""Pose, CameraModel and load_image()."""

import copy
import os
import pickle
import unittest
from pathlib import Path

import numpy as np
import penumbra
from support import RECORDINGS, TABLETOP, TestCase

NAN = float("nan")
BAD = (NAN, float("inf"), -float("inf"))


class Poses(TestCase):
    def test_convert_to_matrices_and_back(self):
        random = np.random.default_rng(3)
        for _ in range(200):
            q = random.normal(size=4) * random.choice([1e-9, 1.0], 4)
            q /= np.linalg.norm(q)
            pose = penumbra.Pose(random.normal(size=3), q)
            T = pose.matrix
            self.assert_same_bits(T[3], np.array([0.0, 0.0, 0.0, 1.0]))
            self.assert_same_bits(np.ascontiguousarray(T[:3, 3]), pose.position)
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-15)
            self.assertGreater(np.linalg.det(T), 0.0)
            # The rotation of a vector, by its definition: q v q*.
            v, (x, y, z, w) = random.normal(size=3), q
            u = np.array([x, y, z])
            turned = v + 2 * np.cross(u, np.cross(u, v) + w * v)
            np.testing.assert_allclose(T[:3, :3] @ v, turned, atol=1e-14)
            again = penumbra.Pose.from_matrix(T).quaternion_xyzw
            np.testing.assert_allclose(again * np.sign(again @ q), q, atol=1e-14)

    def test_are_arrays(self):
        pose = penumbra.Pose([1, 2, 3])
        self.assert_same_bits(np.asarray(pose), pose.matrix)
        self.assertEqual(np.asarray(pose, dtype=np.float32).dtype, np.float32)
        np.testing.assert_array_equal(pose @ np.array([0.0, 0, 0, 1]), [1, 2, 3, 1])
        np.testing.assert_array_equal(np.linalg.inv(pose)[:3, 3], [-1, -2, -3])
        self.assertEqual(pose, penumbra.Pose((1, 2, 3), (0, 0, 0, 1)))
        self.assertNotEqual(pose, penumbra.Pose())
        self.assertNotEqual(pose, "pose")
        self.assertEqual(
            repr(pose), "Pose(position=[1.0, 2.0, 3.0], quaternion_xyzw=[0.0, 0.0, 0.0, 1.0])"
        )
        pose.position[0] = 7  # of a copy
        self.assertEqual(pose.position[0], 1)

    def test_are_pickled_and_copied(self):
        pose = penumbra.Pose([0.1, -2, 3e-9], [0.5, -0.5, 0.5, 0.5])
        for again in (pickle.loads(pickle.dumps(pose)), copy.deepcopy(pose)):
            self.assertEqual(again, pose)
        self.assert_fails(ValueError, "3 fields in place of 2", penumbra.Pose.__setstate__,
                          penumbra.Pose.__new__(penumbra.Pose), (0, 0, 0))

    def test_refuse_what_is_no_rigid_transform(self):
        fails = self.assert_fails
        fails(penumbra.ArgumentError, "has length 2.0; give a unit quaternion", penumbra.Pose,
              [0, 0, 0], [0, 0, 0, 2])
        fails(penumbra.ArgumentError, "quaternion_xyzw", penumbra.Pose, [0, 0, 0], [0, 0, 0, NAN])
        fails(penumbra.ArgumentError, "position: has shape (2,); give 3 numbers", penumbra.Pose,
              [0, 0])
        fails(TypeError, "position: is a str", penumbra.Pose, "abc")
        matrix = penumbra.Pose.from_matrix
        fails(penumbra.ArgumentError, "has shape (3, 4); give", matrix, np.eye(4)[:3])
        fails(penumbra.ArgumentError, "rotation matrix", matrix, np.diag([1, 1, -1, 1]))
        fails(penumbra.ArgumentError, "rotation matrix", matrix, np.diag([2, 2, 2, 1]))
        fails(penumbra.ArgumentError, "rotation matrix", matrix, np.diag([NAN, 1, 1, 1]))
        fails(penumbra.ArgumentError, "last row", matrix, np.ones((4, 4)))
        fails(TypeError, "matrix: is a NoneType", matrix, None)


class CameraModels(TestCase):
    def test_project_like_the_formula(self):
        k1, k2, p1, p2, k3 = -0.215, 0.062, 0.0008, -0.0006, -0.004
        camera = penumbra.CameraModel(
            640, 480, 531.7, 530.4, 322.3, 237.6, distortion=[k1, k2, p1, p2, k3]
        )
        points = np.random.default_rng(2).uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 1.5], (50, 3))
        x, y = (points[:, :2] / points[:, 2:]).T
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        pixels = camera.project(points)
        self.assertEqual(pixels.shape, (50, 2))
        expected = np.column_stack([531.7 * xd + 322.3, 530.4 * yd + 237.6])
        np.testing.assert_allclose(pixels, expected, atol=1e-9)
        self.assert_same_bits(camera.project(points[0]), pixels[0])
        directions = camera.unproject(pixels)
        np.testing.assert_allclose(directions, points / points[:, 2:], atol=1e-8)
        self.assertEqual(camera.unproject([320, 240]).shape, (3,))
        K = [[531.7, 0, 322.3], [0, 530.4, 237.6], [0, 0, 1]]
        np.testing.assert_array_equal(camera.matrix, K)
        np.testing.assert_array_equal(camera.distortion, [k1, k2, p1, p2, k3])

    def test_give_nan_where_there_is_no_pixel(self):
        camera = penumbra.CameraModel.load(TABLETOP / "camera.yaml")
        points = [[0, 0, 1], [0, 0, -1], [NAN, 0, 1], [0, 0, 0], [0, float("inf"), 1]]
        pixels = camera.project(points)
        np.testing.assert_array_equal(np.isnan(pixels).all(axis=1), [False, True, True, True, True])
        self.assertTrue(np.isnan(camera.unproject([NAN, 3])).all())
        self.assertEqual(camera.project(np.zeros((0, 3))).shape, (0, 2))
        fails = self.assert_fails
        fails(penumbra.ArgumentError, "points: has shape (2,); give N x 3, or 3 numbers",
              camera.project, [1, 2])
        fails(penumbra.ArgumentError, "shape (2, 2, 3)", camera.project, np.zeros((2, 2, 3)))
        fails(penumbra.ArgumentError, "pixels", camera.unproject, 5.0)
        fails(TypeError, "points: is a str", camera.project, "points")

    def test_keep_every_parameter(self):
        for model, count in [("plumb_bob", 5), ("rational", 8), ("fisheye", 4)]:
            with self.subTest(model):
                distortion = 1e-3 * np.arange(1, count + 1)
                camera = penumbra.CameraModel(
                    640, 480, 500.0, 501.0, 320.0, 240.0, model, distortion, tone_curve=1.9,
                    rolling_shutter_row_s=2e-5, overlay_sigma_px=0.03,
                )
                camera.save(self.folder / "camera.yaml")
                loaded = penumbra.CameraModel.load(self.folder / "camera.yaml")
                for again in (loaded, pickle.loads(pickle.dumps(camera)), copy.copy(camera)):
                    for name in ("width", "height", "fx", "fy", "cx", "cy", "model", "tone_curve",
                                 "rolling_shutter_row_s", "overlay_sigma_px"):
                        self.assertEqual(getattr(again, name), getattr(camera, name), name)
                    self.assert_same_bits(again.distortion, distortion)
                    self.assertEqual(again.warnings, [])
                # OpenCV has a row or a column of coefficients.
                column = penumbra.CameraModel(640, 480, 5e2, 5e2, 320, 240, model,
                                              distortion[:, None])
                self.assert_same_bits(column.distortion, distortion)
        bare = penumbra.CameraModel(640, 480, 500, 500, 320, 240)
        self.assertIsNone(bare.tone_curve)
        self.assert_same_bits(bare.distortion, np.zeros(5))

    def test_are_checked(self):
        fails = self.assert_fails
        good = dict(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0)
        for name in ("fx", "fy", "cx", "cy"):
            for bad in BAD:
                fails(penumbra.Error, name, penumbra.CameraModel, **(good | {name: bad}))
        for bad in BAD:
            with self.assertRaises(penumbra.Error):
                penumbra.CameraModel(**good, distortion=[bad])
            with self.assertRaises(penumbra.Error):
                penumbra.CameraModel(**good, tone_curve=bad)
        with self.assertRaises(penumbra.Error):
            penumbra.CameraModel(**(good | {"width": 0}))
        fails(penumbra.ArgumentError, "give up to 5 coefficients for 'plumb_bob'",
              penumbra.CameraModel, **good, distortion=np.zeros(8))
        fails(penumbra.ArgumentError, "model: 'brown'", penumbra.CameraModel, **good, model="brown")
        fails(penumbra.Error, "none.yaml", penumbra.CameraModel.load, "none.yaml")
        camera = penumbra.CameraModel(**good)
        fails(penumbra.ArgumentError, "format: 'ros2'", camera.save, self.folder / "c", "ros2")
        fails(penumbra.Error, "none", camera.save, self.folder / "none" / "camera.yaml")


class LoadedImages(TestCase):
    def test_are_read_only_views(self):
        image = penumbra.load_image(TABLETOP / "frames" / "000000.jpg")
        self.assertEqual((image.shape, image.dtype), ((480, 640), np.uint8))
        self.assertFalse(image.flags.writeable)
        self.assertFalse(image.flags.owndata)
        with self.assertRaises(ValueError):
            image[0, 0] = 1

    def test_of_png_have_the_pixels_of_matplotlib(self):
        try:
            from matplotlib.image import imread
        except ImportError:
            self.skipTest("needs matplotlib")
        from matplotlib.image import imsave

        pixels = np.random.default_rng(4).integers(0, 256, (31, 47, 3), np.uint8)
        imsave(self.folder / "colour.png", pixels)
        image = penumbra.load_image(self.folder / "colour.png")
        self.assertEqual(image.shape, (31, 47, 3))
        np.testing.assert_array_equal(image, pixels)
        np.testing.assert_array_equal(imread(self.folder / "colour.png")[:, :, :3] * 255, pixels)

    def test_name_the_file_in_errors(self):
        self.assert_fails(penumbra.Error, "none.png", penumbra.load_image, Path("none.png"))
        self.assert_fails(penumbra.Error, "camera.yaml", penumbra.load_image,
                          TABLETOP / "camera.yaml")
        odd = os.fsdecode(b"odd \xff name.png")  # no UTF-8
        self.assert_fails(penumbra.Error, "odd", penumbra.load_image, odd)
        with self.assertRaises(TypeError):
            penumbra.load_image(5)


class Package(TestCase):
    def test_shows_public_names(self):
        self.assertEqual(penumbra.Error.__mro__[1], RuntimeError)
        self.assertTrue(issubclass(penumbra.ArgumentError, (penumbra.Error, ValueError)))
        self.assertEqual(penumbra.Tracker.__module__, "penumbra")
        self.assertRegex(penumbra.__version__, r"^\d+\.\d+\.\d+$")
        self.assertIn("480", repr(penumbra.CameraModel.load(RECORDINGS / "corner" / "camera.yaml")))


if __name__ == "__main__":
    unittest.main()
