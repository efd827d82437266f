"""Draws cost against error of soft shadows from the table of count-instructions in instructions.md -> SVG."""
import math
import pathlib
import re

from scatter_chart import PANEL_H, PANEL_W, panel, picture

PAGES = pathlib.Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
COLOURS = {"layered": "#1f6fd6", "field": "#c2410c", "pcss": "#8a4fbf", "average": "#6b7280"}
OTHER = "#0f766e"
LEFT, TOP, GAP = 74, 98, 92
STEPS = [step * 10.0 ** power for power in range(-2, 4) for step in (1.0, 3.0)]


def measured():
    """Returns shape -> [(technique, instructions [M], error [grey levels])]."""
    line = re.compile(r"^\| (\w+) \| ([\w-]+) \| ([\d.]+) \| [\d.]+ \| ([\d.]+) \| [\d.]+ \| [-+][\d.]+ % \| [-+][\d.]+ % \|$")
    shapes = {}
    for text in (PAGES / "instructions.md").read_text().splitlines():
        found = line.match(text)
        if found:
            shapes.setdefault(found.group(1), []).append((found.group(2), float(found.group(3)), float(found.group(4))))
    return shapes


def colour_of(name):
    return COLOURS.get(name.split("-")[0], OTHER)


def spanned(values):
    """Returns the largest step below and the smallest step above the values."""
    low = max(step for step in STEPS if step <= min(values))
    high = min(step for step in STEPS if step >= max(values))
    return [step for step in STEPS if low <= step <= high]


def draw(file):
    """Writes the chart, unless the section lacks the table."""
    shapes = measured()
    if not shapes:
        return
    rows = [row for shape in shapes.values() for row in shape]
    costs, errors = spanned([row[1] for row in rows]), spanned([row[2] for row in rows])

    def share(value, steps):
        return math.log(value / steps[0]) / math.log(steps[-1] / steps[0])

    body = []
    for column, (shape, points) in enumerate(shapes.items()):
        body += panel([(name, share(cost, costs) * PANEL_W, (1.0 - share(error, errors)) * PANEL_H) for name, cost, error in points],
                      f"A {shape} of 3000 triangles", LEFT + column * (PANEL_W + GAP), TOP,
                      [(share(step, costs) * PANEL_W, f"{step:g} M") for step in costs],
                      [((1.0 - share(step, errors)) * PANEL_H, f"{step:g}") for step in errors], colour_of)
    file.write_text(picture(LEFT + len(shapes) * (PANEL_W + GAP) - GAP + 60, TOP + PANEL_H + 66, LEFT, "Soft shadows: run time against error",
                            "moving, on one rectangle of the table at 1280 x 720, against an area light's; lower is closer, further left is "
                            "faster", body, "instructions that the shadow takes of a frame (software OpenGL)", "RMS error [grey levels]",
                            TOP + PANEL_H / 2))
