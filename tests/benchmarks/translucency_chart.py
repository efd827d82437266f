"""Translucency modes of shadows as an SVG: cost, error of the density, and moire.

Reads the pages translucency.md (densities, flips) and instructions.md (cost). Blended and retextured shadows are factors, not
patterns: their density is exact, and they have no moire.
"""
import pathlib
import re

from scatter_chart import FAINT, INK, RULE

PAGES = pathlib.Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
COLOURS = {"blend": "#1c6dd0", "retexture": "#0f8f7a", "mesh": "#8a4fbf", "geometry-mesh": "#c2571a"}
TRIANGLES = 48  # selects rows of instructions.md


def measured():
    """Returns (label, mode, density error, standard deviation, fraction of flipping pixels) of each pattern and distance."""
    rows = {}
    line = re.compile(r"^(mesh|geometry-mesh, [\d.]+ px)\s+([\d.]+)\s+\w+\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)\s+[\d.]+\s+[\d.]+\s+([\d.]+) %$")
    for text in (PAGES / "translucency.md").read_text().splitlines():
        found = line.match(text)
        if not found:
            continue
        name, eye, wanted, mean, deviation, flips = found.groups()
        label = f"{name}, {eye} m"
        before = rows.get(label, (0.0, 0.0, 0.0))
        rows[label] = (max(before[0], abs(float(mean) - float(wanted))), max(before[1], float(deviation)),
                       max(before[2], float(flips) / 100))
    exact = [(mode, mode, 0.0, 0.0, 0.0) for mode in ("blend", "retexture")]
    return exact + [(label, label.split(",")[0], *values) for label, values in rows.items()]


def costs():
    """Returns mode -> instructions of the shadow relative to a simple one."""
    line = re.compile(rf"^\| {TRIANGLES} \| moving \| layered \| ([\w-]+) \| [\d.]+ \| [\d.]+ \| ([\d.]+) \|")
    found = (line.match(text) for text in (PAGES / "instructions.md").read_text().splitlines())
    return {match.group(1): float(match.group(2)) for match in found if match}


def panel(rows, left, top, width, title, greatest, form):
    out = [f'<text x="{left}" y="{top - 12}" font-size="13" font-weight="600" fill="{INK}">{title}</text>',
           f'<path d="M{left} {top - 4}V{top + 24 * len(rows)}" stroke="{RULE}"/>']
    for i, (_, mode, value) in enumerate(rows):
        length = width * value / greatest if greatest > 0 else 0
        y = top + 24 * i
        out.append(f'<rect x="{left}" y="{y}" width="{max(length, 1):.1f}" height="15" fill="{COLOURS[mode]}"/>'
                   f'<text x="{left + length + 6:.1f}" y="{y + 12}" fill="{FAINT}">{form(value)}</text>')
    return out


def draw(file):
    """Writes the chart, unless a section lacks some of its data."""
    rows = measured()
    cost = costs()
    missing = sorted({mode for _, mode, *_ in rows} - set(cost))
    if missing or len(rows) < 4:
        return
    top, names, each = 96, 210, 150
    lines = [(label, mode) for label, mode, *_ in rows]
    panels = [("shadow's instructions / simple", [cost[mode] for _, mode in lines], lambda v: f"{v:.2f}"),
              ("density off by, at most", [row[2] for row in rows], lambda v: f"{v:.3f}"),
              ("density sways by (1 sd)", [row[3] for row in rows], lambda v: f"{v:.3f}"),
              ("pixels that flip", [row[4] for row in rows], lambda v: f"{100 * v:.0f} %")]
    width = names + len(panels) * (each + 60) + 20
    height = top + 24 * len(lines) + 30
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
           f'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
           f'<text x="20" y="30" font-size="18" font-weight="600" fill="{INK}">Shadows that let the video shine through</text>',
           f'<text x="20" y="50" fill="{FAINT}">cost of a shadow, {TRIANGLES} triangles; densities of layers in 16 x 16 px windows; pixels that change '
           f'where the camera moves by 0.37 px</text>']
    for i, (label, mode) in enumerate(lines):
        out.append(f'<text x="20" y="{top + 24 * i + 12}" fill="{COLOURS[mode]}">{label}</text>')
    for i, (title, values, form) in enumerate(panels):
        bars = [(label, mode, value) for (label, mode), value in zip(lines, values)]
        out += panel(bars, names + 20 + i * (each + 60), top, each, title, max(values), form)
    file.write_text("\n".join(out + ["</svg>"]) + "\n")
