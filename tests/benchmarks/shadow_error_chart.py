"""Draws run time against error of the shadow techniques: results of shadow_error_benchmark -> SVG."""
import math

from scatter_chart import PANEL_H, PANEL_W, panel, picture

COLOURS = {"layered": "#1f6fd6", "field": "#c2410c", "rays": "#6b7280", "other": "#0f766e"}
LEFT, TOP, GAP = 74, 98, 92
FLOOR = 0.001  # smaller errors are drawn at the lower border
ROW_GAP = 76
STEPS = [step * 10.0 ** power for power in range(-3, 3) for step in (1.0, 3.0)]
MEASURES = (("Area error", lambda row, layer: row["area_error"][layer], lambda e: f"{100 * e:g} %"),
            ("1 - IoU", lambda row, layer: 1.0 - row["iou"][layer], lambda e: f"{e:g}"))
LAYERS = ((0, "umbra"), (2, "penumbra"))  # the middle layer is exact, except for soft shadows


def colour_of(name):
    return COLOURS.get(name.split()[0].rstrip(","), COLOURS["other"])


def milliseconds(x):
    return f"{x:g} ms" if x < 1000 else f"{x / 1000:g} s"


def error_panel(rows, error_of, worst, label_of, title, left, top):
    """One scatter: CPU time (log) to the right, error (log) upwards to `worst`."""
    times = [row["rises_ms"] for row in rows]
    low, high = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)))
    to_x = lambda t: (math.log10(t) - low) / (high - low) * PANEL_W
    to_y = lambda e: (1.0 - math.log10(max(e, FLOOR) / FLOOR) / math.log10(worst / FLOOR)) * PANEL_H
    x_ticks = [(to_x(10.0 ** power), milliseconds(10.0 ** power)) for power in range(low, high + 1)]
    y_ticks = [(to_y(e), label_of(round(e, 6))) for e in STEPS if e <= worst]
    points = [(row["name"], to_x(row["rises_ms"]), to_y(error_of(row))) for row in rows]
    return panel(points, title, left, top, x_ticks, y_ticks, colour_of)


def draw(results):
    rows = results["techniques"]
    body = []
    for line, (name, error_of, label_of) in enumerate(MEASURES):
        largest = max(error_of(row, layer) for row in rows for layer, _ in LAYERS)
        worst = next((step for step in STEPS[1:] if step >= largest), STEPS[-1])
        for column, (layer, layer_name) in enumerate(LAYERS):
            body += error_panel(rows, lambda row: error_of(row, layer), worst, label_of, f"{name}, {layer_name}",
                                LEFT + column * (PANEL_W + GAP), TOP + line * (PANEL_H + ROW_GAP))
    bottom = TOP + 2 * PANEL_H + ROW_GAP
    return picture(LEFT + 2 * PANEL_W + GAP + 50, bottom + 66, LEFT,
                   "Shadow techniques: run time against error",
                   "against a ray-cast area light, mean of 8 meshes, 256 by 256 cells, one core; lower is closer, further left is faster",
                   body, "CPU time when the object rises", "error", (TOP + bottom) / 2)
