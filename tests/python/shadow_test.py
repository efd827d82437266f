"""shadow_layers() and make_kernels(): the numbers of `penumbra shadow` and `penumbra kernels`."""

import gc
import json
import unittest

import numpy as np
import penumbra
from support import HELICOPTER, TestCase, run

POSE = penumbra.Pose([0.1, -0.05, 0.12], [0, 0, 0.6, 0.8])
PLATE = ([[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0], [-0.05, 0.05, 0]],
         [[0, 1, 2], [0, 2, 3]])
BAD = (float("nan"), float("inf"), -float("inf"))


class ShadowCommand(TestCase):
    def check(self, options, **named):
        model = penumbra.Model.load(HELICOPTER)
        found = penumbra.shadow_layers(model, T_world_object=POSE, **named)
        expected = json.loads(run("shadow", HELICOPTER, "--pose", "0.1 -0.05 0.12 0 0 0.6 0.8",
                                  "--output", "-", *options))
        self.assertEqual(set(found.layers), set(expected["layers"]))
        for name, layer in found.layers.items():
            written = expected["layers"][name]
            self.assertEqual((layer.name, layer.area_m2), (name, written["area"]))
            self.assertEqual(len(layer.polygons), len(written["polygons"]))
            for polygon, corners in zip(layer.polygons, written["polygons"]):
                np.testing.assert_array_equal(polygon.outer, corners["outer"])
                self.assertEqual([hole.tolist() for hole in polygon.holes], corners["holes"])
        self.assertEqual(found.twisted_faces, expected["twisted_faces"])
        self.assertEqual(found.kernel_source, expected["kernels"]["source"])
        self.assertEqual(found.warnings, expected["warnings"])

    def test_has_the_same_layers(self):
        light = penumbra.LightConstants
        for options, named in [
            ([], {}),
            (["--kernels", "cocl"], {"kernels": "cocl"}),
            (["--kernels", "per-axis"], {"kernels": "per-axis"}),
            (["--light-mode", "fixed"], {"light_mode": "fixed"}),
            (["--workspace-height", "0.3", "--magnification", "1.5",
              "--plane", "0.1 0 1 0 0 -0.02"],
             {"light": penumbra.light_for_workspace(0.3, 1.5), "plane_normal": [0.1, 0, 1],
              "plane_point": [0, 0, -0.02]}),
            (["--light-height", "inf", "--umbra-height", "0.3"],
             {"light": light(float("inf"), umbra_height_m=0.3)}),
            (["--technique", "simple"], {"technique": "simple"}),
            (["--technique", "hard", "--light", "0.3 0.2 1 1"],
             {"technique": "hard", "hard_light": (0.3, 0.2, 1, 1)}),
            (["--technique", "field"], {"technique": "field"}),
        ]:
            with self.subTest(options):
                self.check(options, **named)

    def test_writes_the_same_kernels(self):
        model = penumbra.Model.load(HELICOPTER)
        kernels = penumbra.make_kernels(model, source="smooth")
        kernels.save(self.folder / "found.json")
        run("kernels", HELICOPTER, "--kernels", "smooth", "--output", self.folder / "expected.json")
        found = json.loads((self.folder / "found.json").read_text())
        expected = json.loads((self.folder / "expected.json").read_text())
        self.assertEqual(found["kernels"], expected["kernels"])
        self.assertGreater(len(kernels.points), 100)


class Layers(TestCase):
    def test_follow_the_formula(self):
        model = penumbra.Model(*PLATE)
        for h in (0.0, 0.05, 0.1, 0.2):
            T = np.eye(4)
            T[2, 3] = h
            shadow = penumbra.shadow_layers(model, T_world_object=T)
            for name, sign in [("umbra", -1), ("middle", 0), ("penumbra", 1)]:
                s = (0.9 + sign * 3 * h) / (0.9 - h)
                area = shadow.layers[name].area_m2
                self.assertAlmostEqual(area, 0.01 * s * s, delta=2e-4 * s * s)
            self.assertAlmostEqual(shadow.object.area_m2, 0.01, delta=1e-7)

    def test_are_shared_arrays(self):
        polygon = penumbra.shadow_layers(penumbra.Model(*PLATE)).layers["middle"].polygons[0]
        gc.collect()  # the polygon keeps the shadow alive
        outer = polygon.outer
        self.assertEqual((outer.shape[1], outer.dtype), (2, np.float64))
        self.assertTrue(np.shares_memory(outer, polygon.outer))
        self.assertFalse(outer.flags.writeable)
        corners = outer.copy()
        del polygon
        gc.collect()
        np.testing.assert_array_equal(outer, corners)
        u, v = corners.T
        area = 0.5 * np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v)
        self.assertAlmostEqual(area, 0.01, delta=1e-6)  # counter-clockwise

    def test_of_stored_kernels_are_the_same(self):
        model = penumbra.Model.load(HELICOPTER)
        kernels = penumbra.make_kernels(model)
        kernels.save(self.folder / "kernels.json")
        self.assert_same_bits(kernels.up, np.array([0.0, 0.0, 1.0]))
        expected = penumbra.shadow_layers(model, T_world_object=POSE)
        for given in (kernels, penumbra.Kernels.load(self.folder / "kernels.json")):
            found = penumbra.shadow_layers(model, T_world_object=POSE, kernels=given)
            for name, layer in expected.layers.items():
                self.assertEqual(found.layers[name].area_m2, layer.area_m2)
        self.assert_fails(penumbra.Error, "triples", penumbra.shadow_layers,
                          penumbra.Model(*PLATE), kernels=kernels)


class Arguments(TestCase):
    def test_of_layers_are_checked(self):
        model = penumbra.Model(*PLATE)

        def fails(kind, text, **named):
            self.assert_fails(kind, text, penumbra.shadow_layers, model, **named)

        for bad in BAD:
            lost = np.eye(4)
            lost[0, 3] = bad
            fails(penumbra.Error, "position", T_world_object=lost)
            fails(penumbra.Error, "scale", scale=bad)
            fails(penumbra.Error, "plane: normal", plane_normal=[0, 0, bad])
            fails(penumbra.Error, "plane: point", plane_point=[0, 0, bad])
            fails(penumbra.Error, "ratio", light=penumbra.LightConstants(ratio=bad))
            fails(penumbra.Error, "light", light=penumbra.LightConstants(bad))
            fails(penumbra.Error, "hard_light", technique="hard", hard_light=[0, 0, bad, 1])
        fails(penumbra.Error, "normal", plane_normal=[0, 0, 0])
        fails(penumbra.Error, "one of the two", light=penumbra.LightConstants(0.9, 3.0, 0.3))
        fails(penumbra.Error, "no such node", groups=["none"])
        fails(penumbra.Error, "light_mode", light_mode="fixed", kernels="cocl")
        argument = penumbra.ArgumentError
        fails(argument, "technique: 'soft' is not known; give 'layered', 'field', 'simple' or "
              "'hard'", technique="soft")
        fails(argument, "kernels: 'centroid'", kernels="centroid")
        fails(argument, "light_mode: 'big'", light_mode="big")
        fails(argument, "plane_normal: has shape (2,)", plane_normal=[0, 1])
        fails(argument, "T_world_object: has shape (3,)", T_world_object=[0, 0, 1])
        fails(TypeError, "kernels: is a int", kernels=5)
        fails(TypeError, "groups: is a str", groups="all")

    def test_of_kernels_are_checked(self):
        model = penumbra.Model(*PLATE)
        fails, make = self.assert_fails, penumbra.make_kernels
        fails(penumbra.Error, "direction", make, model, [0, 0, 0])
        fails(penumbra.Error, "direction", make, model, [0, BAD[0], 1])
        fails(penumbra.ArgumentError, "source: 'x'", make, model, source="x")
        fails(penumbra.Error, "no such node", make, model, groups=["none"])
        fails(penumbra.Error, "none.json", penumbra.Kernels.load, "none.json")

    def test_of_models_are_checked(self):
        fails, model = self.assert_fails, penumbra.Model
        positions, triangles = PLATE
        fails(penumbra.Error, "no triangles", model, positions, [])
        fails(penumbra.Error, "vertex 4 does not exist", model, positions, [[0, 1, 4]])
        fails(penumbra.ArgumentError, "triangles[0]: -1 is no index", model, positions,
              [[0, 1, -1]])
        fails(penumbra.ArgumentError, "triangles: has shape (2, 2); give N x 3", model, positions,
              [[0, 1], [1, 2]])
        fails(TypeError, "triangles: is a float64 array", model, positions, [[0.0, 1, 2]])
        fails(penumbra.ArgumentError, "positions: has shape (4,)", model, [1, 2, 3, 4], triangles)
        for bad in (*BAD, 1e7):
            fails(penumbra.Error, "tent: positions[1]", model,
                  [positions[0], [0, bad, 0], *positions[2:]], triangles, "tent")
        fails(penumbra.Error, "none.glb", model.load, "none.glb")
        fails(penumbra.Error, "unit_m", model.load, HELICOPTER, unit_m=0.0)
        fails(penumbra.ArgumentError, "up: 'x'", model.load, HELICOPTER, up="x")
        loaded = model.load(HELICOPTER, up="y", unit_m=1.0)
        self.assertEqual(loaded.triangle_count, model.load(HELICOPTER).triangle_count)
        self.assertGreater(loaded.vertex_count, 3)
        self.assertEqual(loaded.warnings, [])

    def test_of_workspaces_are_checked(self):
        light = penumbra.light_for_workspace(0.3, 1.5)
        self.assertAlmostEqual(light.height_m / light.ratio, 0.3)
        self.assertIsNone(light.umbra_height_m)
        for bad in (*BAD, 0.0):
            with self.assertRaises(penumbra.Error):
                penumbra.light_for_workspace(bad, 1.5)
            with self.assertRaises(penumbra.Error):
                penumbra.light_for_workspace(0.3, bad)


if __name__ == "__main__":
    unittest.main()
