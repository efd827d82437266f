"""Draws run time against error of the shadow techniques: what shadow_error_benchmark measured -> SVG."""
import math

INK, FAINT, RULE = "#1d2430", "#5b6675", "#d5dae1"
COLOURS = {"layered": "#1f6fd6", "field": "#c2410c", "rays": "#6b7280", "other": "#0f766e"}
PANEL_W, PANEL_H, LEFT, TOP, GAP = 400, 300, 74, 98, 92
FLOOR = 0.001  # errors below are drawn on the lower edge


def colour_of(name):
    return COLOURS.get(name.split()[0].rstrip(","), COLOURS["other"])


def milliseconds(x):
    return f"{x:g} ms" if x < 1000 else f"{x / 1000:g} s"


def place_labels(points, width):
    """A place for each label beside its point, where it meets no other label or point: the free one nearest to it."""
    taken = [(x - 7, y - 7, x + 7, y + 7) for _, x, y in points]
    placed = []
    for name, x, y in sorted(points, key=lambda p: p[2]):
        w, h = 6.4 * len(name) + 4, 14
        best = None
        for ring in range(0, 7):
            for dx, dy in ((10, 4), (-10 - w, 4), (-w / 2, -10), (-w / 2, 18), (10, -8), (10, 16), (-10 - w, -8), (-10 - w, 16)):
                left, base = x + dx, y + dy + (ring * 13 if dy > 4 else -ring * 13 if dy < 4 else (ring % 2 * 2 - 1) * ring * 7)
                box = (left, base - h + 3, left + w, base + 3)
                if left < 2 or left + w > width + 40 or base < 10 or base > PANEL_H - 3:
                    continue
                if any(box[0] < t[2] and t[0] < box[2] and box[1] < t[3] and t[1] < box[3] for t in taken):
                    continue
                cost = abs(left + (0 if dx > 0 else w) - x) + abs(base - y) + 12 * ring
                if best is None or cost < best[0]:
                    best = (cost, left, base, box)
        if best is None:
            best = (0, x + 10, y + 4, (0, 0, 0, 0))
        taken.append(best[3])
        placed.append((name, x, y, best[1], best[2]))
    return placed


def panel(rows, layer, title, left):
    """One layer's scatter: CPU time (log) to the right, 1 - IoU (log) upwards."""
    times = [row["rises_ms"] for row in rows]
    low, high = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)))
    to_x = lambda t: (math.log10(t) - low) / (high - low) * PANEL_W
    to_y = lambda e: -math.log10(max(e, FLOOR)) / -math.log10(FLOOR) * PANEL_H
    out = [f'<g transform="translate({left} {TOP})">',
           f'<text x="0" y="-14" font-size="15" font-weight="600" fill="{INK}">{title}</text>']
    for power in range(low, high + 1):
        x = to_x(10.0 ** power)
        out.append(f'<path d="M{x:.1f} 0V{PANEL_H}" stroke="{RULE}"/>'
                   f'<text x="{x:.1f}" y="{PANEL_H + 18}" text-anchor="middle" fill="{FAINT}">{milliseconds(10.0 ** power)}</text>')
    for error, label in ((1, "0"), (0.3, "0.7"), (0.1, "0.9"), (0.03, "0.97"), (0.01, "0.99"), (0.003, "0.997"), (0.001, "0.999")):
        y = to_y(error)
        out.append(f'<path d="M0 {y:.1f}H{PANEL_W}" stroke="{RULE}"/>'
                   f'<text x="-8" y="{y + 4:.1f}" text-anchor="end" fill="{FAINT}">{label}</text>')
    points = [(row["name"], to_x(row["rises_ms"]), to_y(1.0 - row["iou"][layer])) for row in rows]
    for name, x, y, label_x, label_y in place_labels(points, PANEL_W):
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour_of(name)}"/>'
                   f'<text x="{label_x:.1f}" y="{label_y:.1f}" fill="{colour_of(name)}" stroke="#ffffff" stroke-width="3" '
                   f'paint-order="stroke">{name}</text>')
    out.append("</g>")
    return out


def draw(results):
    rows = results["techniques"]
    width, height = LEFT + 2 * PANEL_W + GAP + 50, TOP + PANEL_H + 66
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
           f'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
           f'<text x="{LEFT}" y="30" font-size="18" font-weight="600" fill="{INK}">Shadow techniques: run time against agreement with a ray-cast area light</text>',
           f'<text x="{LEFT}" y="50" fill="{FAINT}">mean of 8 meshes, 256 by 256 cells, one core; lower is closer to the light, further left is faster</text>']
    out += panel(rows, 0, "Umbra", LEFT)
    out += panel(rows, 2, "Penumbra", LEFT + PANEL_W + GAP)
    middle = TOP + PANEL_H / 2
    out.append(f'<text x="20" y="{middle}" fill="{FAINT}" text-anchor="middle" transform="rotate(-90 20 {middle})">IoU with the reference</text>')
    out.append(f'<text x="{width / 2}" y="{height - 14}" fill="{FAINT}" text-anchor="middle">CPU time when the object rises</text>')
    out.append("</svg>")
    return "\n".join(out) + "\n"
