#!/usr/bin/python3
"""Plots the areas of the shadow layers of a model over the light's height H and ratio a:

    sweep_shadow.py helicopter.glb areas.png

Each panel has one ratio a, each line style one height H. The area is relative to that of the object
seen from above.
"""

import sys

import matplotlib

matplotlib.use("Agg")  # without a display
import matplotlib.pyplot as plt
import numpy as np
import penumbra

HEIGHTS_M = {0.6: ":", 0.9: "-", 1.5: "--"}  # H -> style of the line
RATIOS = (1.5, 3.0, 6.0)  # a
COLOURS = {"umbra": "black", "middle": "tab:blue", "penumbra": "tab:orange"}


def main(file, plot):
    model = penumbra.Model.load(file)
    kernels = penumbra.make_kernels(model)  # once for all shadows
    above_plane_m = np.linspace(0.0, 0.3, 13)  # height of the object
    figure, panels = plt.subplots(1, 3, figsize=(11, 4), sharey=True, layout="constrained")
    for axes, ratio in zip(panels, RATIOS):
        for height_m, style in HEIGHTS_M.items():
            light = penumbra.LightConstants(height_m=height_m, ratio=ratio)
            areas: dict[str, list[float]] = {name: [] for name in COLOURS}
            for z in above_plane_m:
                shadow = penumbra.shadow_layers(model, T_world_object=penumbra.Pose([0, 0, z]),
                                                light=light, kernels=kernels)
                for name, layer in shadow.layers.items():
                    areas[name].append(layer.area_m2 / shadow.object.area_m2)
            for name, values in areas.items():
                axes.plot(above_plane_m, values, style, color=COLOURS[name])
            print(f"a {ratio}, H {height_m} m: the umbra vanishes at {height_m / ratio:.2f} m")
        axes.set(title=f"a = {ratio:g}", xlabel="height of the object [m]", xlim=(0, 0.3),
                 xticks=(0, 0.1, 0.2, 0.3), ylim=(0, 8))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("area of the layer / of the object")
    for name, colour in COLOURS.items():
        panels[0].plot([], [], color=colour, label=name)
    for height_m, style in HEIGHTS_M.items():
        panels[0].plot([], [], style, color="grey", label=f"H = {height_m} m")
    panels[0].legend(loc="upper left")
    figure.savefig(plot, dpi=150)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: sweep_shadow.py MODEL areas.png")
    try:
        main(*sys.argv[1:])
    except penumbra.Error as error:
        sys.exit(f"sweep_shadow.py: {error}")
