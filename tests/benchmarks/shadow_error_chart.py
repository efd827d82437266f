"""Draws run time against error of the shadow techniques: what shadow_error_benchmark measured -> SVG."""
import math

from scatter_chart import PANEL_H, PANEL_W, panel, picture

COLOURS = {"layered": "#1f6fd6", "field": "#c2410c", "rays": "#6b7280", "other": "#0f766e"}
LEFT, TOP, GAP = 74, 98, 92
FLOOR = 0.001  # errors below are drawn on the lower edge


def colour_of(name):
    return COLOURS.get(name.split()[0].rstrip(","), COLOURS["other"])


def milliseconds(x):
    return f"{x:g} ms" if x < 1000 else f"{x / 1000:g} s"


def layer_panel(rows, layer, title, left):
    """One layer's scatter: CPU time (log) to the right, 1 - IoU (log) upwards."""
    times = [row["rises_ms"] for row in rows]
    low, high = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)))
    to_x = lambda t: (math.log10(t) - low) / (high - low) * PANEL_W
    to_y = lambda e: -math.log10(max(e, FLOOR)) / -math.log10(FLOOR) * PANEL_H
    x_ticks = [(to_x(10.0 ** power), milliseconds(10.0 ** power)) for power in range(low, high + 1)]
    y_ticks = [(to_y(error), label) for error, label in ((1, "0"), (0.3, "0.7"), (0.1, "0.9"), (0.03, "0.97"), (0.01, "0.99"),
                                                         (0.003, "0.997"), (0.001, "0.999"))]
    points = [(row["name"], to_x(row["rises_ms"]), to_y(1.0 - row["iou"][layer])) for row in rows]
    return panel(points, title, left, TOP, x_ticks, y_ticks, colour_of)


def draw(results):
    rows = results["techniques"]
    body = layer_panel(rows, 0, "Umbra", LEFT) + layer_panel(rows, 2, "Penumbra", LEFT + PANEL_W + GAP)
    return picture(LEFT + 2 * PANEL_W + GAP + 50, TOP + PANEL_H + 66, LEFT,
                   "Shadow techniques: run time against agreement with a ray-cast area light",
                   "mean of 8 meshes, 256 by 256 cells, one core; lower is closer to the light, further left is faster",
                   body, "CPU time when the object rises", "IoU with the reference", TOP + PANEL_H / 2)
