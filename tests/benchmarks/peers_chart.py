"""Draws run time against error of the tracker and its peers: results of peers_benchmark -> SVG."""
import math

from scatter_chart import PANEL_H, PANEL_W, panel, picture

COLOURS = {"penumbra": "#1f6fd6", "libapriltag": "#c2410c", "OpenCV": "#6b7280", "ViSP": "#0f766e"}
LEFT, TOP, GAP, ROW = 90, 98, 84, 390
PANELS = (("tabletop", "tabletop"), ("grazing", "grazing: seen from low"), ("shake", "shake: motion blur, a hand over the board"), ("single", "single: one tag"))


def colour_of(name):
    return COLOURS.get(name.split()[0], "#000000")


def label_of(row):
    """The name without the words that all rows share. If some poses are wrong or missing, also the number of right ones and of frames."""
    label = row["name"].replace(" + PnP", "").replace(" + our pose", ", our pose")
    good = row["posed"] - row["wrong"]
    return label if good == row["frames"] else f"{label} ({good}/{row['frames']})"


def ticks(low, high, to_pixels, unit):
    return [(to_pixels(10.0 ** power), f"{10.0 ** power:g}{unit}") for power in range(low, high + 1)]


def recording_panel(rows, title, left, top):
    rows = [row for row in rows if row["posed"] and not row["name"].endswith("our pose")]
    times, errors = [row["median_ms"] for row in rows], [row["overlay_rms_px"] for row in rows]
    low_t, high_t = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)))
    low_e, high_e = math.floor(math.log10(min(errors))), math.ceil(math.log10(max(errors)))
    to_x = lambda t: (math.log10(t) - low_t) / (high_t - low_t) * PANEL_W
    to_y = lambda e: (high_e - math.log10(e)) / (high_e - low_e) * PANEL_H
    points = [(label_of(row), to_x(row["median_ms"]), to_y(row["overlay_rms_px"])) for row in rows]
    return panel(points, title, left, top, ticks(low_t, high_t, to_x, " ms"), ticks(low_e, high_e, to_y, " px"), colour_of)


def draw(results):
    shown = [(name, title) for name, title in PANELS if name in results["recordings"]]
    body = []
    for i, (name, title) in enumerate(shown):
        body += recording_panel(results["recordings"][name], title, LEFT + i % 2 * (PANEL_W + GAP), TOP + i // 2 * ROW)
    rows = (len(shown) + 1) // 2
    bottom = TOP + (rows - 1) * ROW + PANEL_H
    return picture(LEFT + 2 * PANEL_W + GAP + 50, bottom + 66, LEFT, "Trackers: run time against error",
                   "the same frames in one run, one core; lower is closer to the truth, further left is faster; in brackets: frames posed within 5 px, where not all are",
                   body, "median CPU time of a frame", "overlay error, RMS over the frames with a pose", (TOP + bottom) / 2)
