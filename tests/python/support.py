"""What the tests of the Python package share: paths of the program and the data."""

import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import penumbra

SOURCE = Path(os.environ["PENUMBRA_SOURCE_DIR"])
PROGRAM = os.environ["PENUMBRA_PROGRAM"]
RECORDINGS = SOURCE / "recordings"
TABLETOP = RECORDINGS / "tabletop"
HELICOPTER = SOURCE / "scenes" / "models" / "helicopter.glb"


def shared_recording(name):
    """The folder of a shared recording. Skips the test without them, as the tests in C++ do."""
    given = os.environ.get("PENUMBRA_SHARED")
    folder = Path(given) if given else SOURCE.parent / "shared"
    if not (folder / "recordings" / "tabletop").is_dir():
        if given:
            raise RuntimeError(f"PENUMBRA_SHARED: {folder} holds no shared recordings")
        raise unittest.SkipTest("no shared recordings")
    return folder / "recordings" / name


def run(*arguments, program=PROGRAM):
    """Runs the program without a display and returns its output; raises with its error."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe"}
    result = subprocess.run(
        [program, *map(str, arguments)], capture_output=True, text=True, env=environment
    )
    if result.returncode != 0:
        raise AssertionError(f"{arguments}: exit code {result.returncode}: {result.stderr}")
    return result.stdout


def first_frame():
    return penumbra.Recording(TABLETOP)[0]


def tabletop_tracker(**options):
    recording = penumbra.Recording(TABLETOP)
    return penumbra.Tracker(recording.camera, recording.tags, **options)


class TestCase(unittest.TestCase):
    """With a temporary folder, and checks of messages and arrays."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def assert_fails(self, kind, text, function, *arguments, **named):
        """Expects an exception of exactly this type with a message of one line."""
        with self.assertRaises(kind) as caught:
            function(*arguments, **named)
        self.assertIs(type(caught.exception), kind)
        self.assertIn(text, str(caught.exception))
        self.assertNotIn("\n", str(caught.exception))

    def assert_same_bits(self, found, expected):
        found, expected = np.asarray(found), np.asarray(expected)
        self.assertEqual(found.shape, expected.shape)
        self.assertEqual(found.dtype, expected.dtype)
        self.assertEqual(found.tobytes(), expected.tobytes())
