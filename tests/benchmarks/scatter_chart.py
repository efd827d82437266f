"""Scatter charts as SVG: one dot per method, run time (log) to the right, error (log) upwards."""

INK, FAINT, RULE = "#1d2430", "#5b6675", "#d5dae1"
PANEL_W, PANEL_H = 400, 300


def place_labels(points, width):
    """Places each label beside its point at the nearest position without overlap, away from other points if possible."""
    taken = [(x - 7, y - 7, x + 7, y + 7) for _, x, y in points]
    placed = []
    for name, x, y in sorted(points, key=lambda p: p[2]):
        w, h = 6.4 * len(name) + 4, 14
        others = [(px, py) for other, px, py in points if other != name]
        best = None
        for ring in range(0, 7):
            for dx, dy in ((10, 4), (-10 - w, 4), (-w / 2, -10), (-w / 2, 18), (10, -8), (10, 16), (-10 - w, -8), (-10 - w, 16)):
                left, base = x + dx, y + dy + (ring * 13 if dy > 4 else -ring * 13 if dy < 4 else (ring % 2 * 2 - 1) * ring * 7)
                box = (left, base - h + 3, left + w, base + 3)
                if left < 2 or left + w > width + 40 or base < 10 or base > PANEL_H - 3:
                    continue
                if any(box[0] < t[2] and t[0] < box[2] and box[1] < t[3] and t[1] < box[3] for t in taken):
                    continue
                near = sum(box[0] - 30 < px < box[2] + 30 and box[1] - 6 < py < box[3] + 6 for px, py in others)
                cost = abs(left + (0 if dx > 0 else w) - x) + abs(base - y) + 12 * ring + 60 * near
                if best is None or cost < best[0]:
                    best = (cost, left, base, box)
        if best is None:
            best = (0, x + 10, y + 4, (0, 0, 0, 0))
        taken.append(best[3])
        placed.append((name, x, y, best[1], best[2]))
    return placed


def panel(points, title, left, top, x_ticks, y_ticks, colour_of):
    """points: (label, x, y) in the panel's pixels; ticks: (x or y in pixels, label)."""
    out = [f'<g transform="translate({left} {top})">',
           f'<text x="0" y="-14" font-size="15" font-weight="600" fill="{INK}">{title}</text>']
    for x, label in x_ticks:
        out.append(f'<path d="M{x:.1f} 0V{PANEL_H}" stroke="{RULE}"/>'
                   f'<text x="{x:.1f}" y="{PANEL_H + 18}" text-anchor="middle" fill="{FAINT}">{label}</text>')
    for y, label in y_ticks:
        out.append(f'<path d="M0 {y:.1f}H{PANEL_W}" stroke="{RULE}"/>'
                   f'<text x="-8" y="{y + 4:.1f}" text-anchor="end" fill="{FAINT}">{label}</text>')
    for name, x, y, label_x, label_y in place_labels(points, PANEL_W):
        colour = colour_of(name)
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
                   f'<text x="{label_x:.1f}" y="{label_y:.1f}" fill="{colour}" stroke="#ffffff" stroke-width="3" '
                   f'paint-order="stroke">{name}</text>')
    out.append("</g>")
    return out


def picture(width, height, left, title, subtitle, body, x_label, y_label, y_label_at):
    """Returns the whole SVG with its panels."""
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
           f'font-family="DejaVu Sans, Helvetica, Arial, sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
           f'<text x="{left}" y="30" font-size="18" font-weight="600" fill="{INK}">{title}</text>',
           f'<text x="{left}" y="50" fill="{FAINT}">{subtitle}</text>']
    out += body
    out.append(f'<text x="20" y="{y_label_at}" fill="{FAINT}" text-anchor="middle" transform="rotate(-90 20 {y_label_at})">{y_label}</text>')
    out.append(f'<text x="{width / 2}" y="{height - 14}" fill="{FAINT}" text-anchor="middle">{x_label}</text>')
    out.append("</svg>")
    return "\n".join(out) + "\n"
