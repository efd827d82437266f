"""Recording: frames with times, as `penumbra replay` reads them."""

import decimal
import shutil
import struct
import unittest
import zlib
from pathlib import Path

import numpy as np
import penumbra
from support import RECORDINGS, TABLETOP, TestCase, run, shared_recording

HEADER = "frame,timestamp_s,file\n"


def write_png(file, pixels, bits=8):
    """Writes a grey PNG of 8 or 16 bits."""
    rows = b"".join(b"\0" + row.astype(">u2" if bits == 16 else "u1").tobytes() for row in pixels)

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], bits, 0, 0, 0, 0)
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) +
                     chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


class Frames(TestCase):
    def test_have_images_and_times(self):
        recording = penumbra.Recording(TABLETOP)
        self.assertEqual((len(recording), recording.notices), (120, []))
        frames = list(recording[:3])
        self.assertEqual([frame.number for frame in frames], [0, 1, 2])
        self.assertEqual([frame.time_ns for frame in frames], [0, 33333000, 66667000])
        self.assertEqual(frames[1].file, TABLETOP / "frames" / "000001.jpg")
        self.assertIsNone(frames[0].exposure_s)
        self.assertEqual((frames[0].image.shape, frames[0].image.dtype), ((480, 640), np.uint8))
        self.assertFalse(frames[0].image.flags.writeable)
        np.testing.assert_array_equal(recording[-1].image, recording[119].image)
        self.assertEqual([frame.number for frame in recording[100::10]], [100, 110])
        with self.assertRaises(IndexError):
            recording[120]
        with self.assertRaises(AttributeError):
            frames[0].number = 5
        self.assertEqual(len(list(recording[:4])), len(list(recording[:4])))  # iterates again

    def test_have_the_files_beside_them(self):
        recording = penumbra.Recording(str(RECORDINGS / "corner"))
        self.assertEqual((recording.camera.width, len(recording.tags)), (640, 18))
        self.assertEqual(len(recording.groundtruth), len(recording))
        self.assertEqual(recording.group_groundtruth, {})
        self.assertIs(recording.camera, recording.camera)  # read once
        calibration = penumbra.Recording(shared_recording("chessboard"))
        self.assert_fails(penumbra.Error, "tags.yaml", lambda: calibration.tags)


class Written(TestCase):
    """Recordings that a test writes."""

    def write(self, listing, frames=3, folder="session"):
        folder = self.folder / folder
        (folder / "frames").mkdir(parents=True)
        for i in range(frames):
            write_png(folder / "frames" / f"{i}.png", np.full((4, 6), 10 * i))
        if listing is not None:
            (folder / "timestamps.csv").write_bytes(listing.encode())
        return folder

    def fails(self, text, listing, **named):
        folder = self.write(listing, folder=f"session {text[:20]!r}".replace("/", " "), **named)
        self.assert_fails(penumbra.Error, text, penumbra.Recording, folder)

    def test_listings_are_read_like_those_of_replay(self):
        folder = self.write(
            "\ufeff# a comment\r\nfile, frame ,gain,exposure_s,timestamp_s\r\n\r\n"
            "frames/0.png,3,x,0.008,-1.5\r\n# more\r\nframes/1.png,5,y,,1e-9\r\n"
            "frames/2.png,6,z,2e-2,+12.0000000005"
        )
        recording = penumbra.Recording(folder)
        self.assertEqual(
            [(frame.number, frame.time_ns, frame.exposure_s) for frame in recording],
            [(3, -1_500_000_000, 0.008), (5, 1, None), (6, 12_000_000_001, 0.02)],
        )
        self.assertEqual([int(frame.image[0, 0]) for frame in recording], [0, 10, 20])
        self.assert_fails(penumbra.Error, "camera.yaml", lambda: recording.camera)
        self.assertIsNone(recording.groundtruth)

    def test_times_do_not_depend_on_the_decimal_context(self):
        with decimal.localcontext() as context:
            context.prec = 3
            frames = list(penumbra.Recording(self.write(HEADER + "0,12.3456789,frames/0.png\n")))
        self.assertEqual(frames[0].time_ns, 12_345_678_900)

    def test_lines_that_are_wrong_are_named(self):
        row = "0,0.0,frames/0.png\n"
        self.fails("timestamps.csv: no such file", None)
        self.fails("is empty", "")
        self.fails("lists 0 frames", HEADER)
        self.fails("line 1: has no column timestamp_s", "frame,time,file\n")
        self.fails("line 3: has 2 fields; the first line names 3", HEADER + row + "1,0.1\n")
        for bad in ("-1", "1.5", "x", "1000000000", "\u0661"):
            self.fails(f"line 2: frame: '{bad}'", HEADER + f"{bad},0,frames/0.png\n")
        for bad in ("nan", "inf", "1,", "1e20", "1e999", "", "0x1", "1_0"):
            with self.assertRaises(penumbra.Error, msg=bad):
                penumbra.Recording(self.write(HEADER + f"0,{bad},frames/0.png\n", folder=f"t{bad}"))
        self.fails("line 3: timestamp_s: 0.0 s does not come after", HEADER + row +
                   "1,0.0,frames/1.png\n")
        self.fails("line 3: frame: 0 does not come after 0", HEADER + row + "0,0.1,frames/1.png\n")
        for bad in ("/etc/passwd", "../0.png", "frames/../../0.png", ""):
            self.fails(f"line 2: file: '{bad}' is not a path inside", HEADER + f"0,0,{bad}\n")
        for bad in ("0", "-1", "61", "nan", "x"):
            self.fails(f"exposure_s: '{bad}'", "frame,timestamp_s,file,exposure_s\n"
                       f"0,0,frames/0.png,{bad}\n")

    def test_wall_clock_times_are_read(self):
        header = "frame,timestamp_s,file,wall_time_ns\n"
        folder = self.write(header + "0,0.0,frames/0.png,1795840177123456789\n"
                            "1,0.1,frames/1.png,\n2,0.2,frames/2.png,-5\n")
        self.assertEqual([frame.wall_time_ns for frame in penumbra.Recording(folder)],
                         [1795840177123456789, None, -5])
        self.assertIsNone(next(iter(penumbra.Recording(RECORDINGS / "tabletop"))).wall_time_ns)
        folder = self.write(header + "0,0.0,frames/0.png,1795840177123456789\n"
                            "1,0.1,frames/1.png,17958401", folder="cut")
        self.assertEqual([frame.wall_time_ns for frame in penumbra.Recording(folder)],
                         [1795840177123456789, None])
        for bad in ("1.5", "x", "1e9", "9223372036854775808", "2026-11-28T04:29:37Z"):
            self.fails(f"wall_time_ns: '{bad}'", header + f"0,0,frames/0.png,{bad}\n")

    def test_damaged_listings_are_read_or_refused(self):
        folder = self.write("")
        good = "frame,timestamp_s,file,exposure_s,wall_time_ns\n" + "".join(
            f"{i},{0.1 * i:.6f},frames/{i}.png,0.01,{i}\n" for i in range(3))
        random = np.random.default_rng(6)
        pieces = [b"\0", b",", b"\n", b"\r", b"-", b"e9", b"9" * 5000, b"0" * 5000, b"nan", b"\xff",
                  b"\xd9\xa1", b"#", b"../", b"\x1b[31m", b" ", b"\xef\xbb\xbf", b"/"]
        read = 0
        for _ in range(1500):
            text = bytearray(good.encode())
            for _ in range(random.integers(1, 4)):
                at = random.integers(0, len(text) + 1)
                piece = pieces[random.integers(len(pieces))]
                text[at : at + random.integers(0, 3)] = piece
            (folder / "timestamps.csv").write_bytes(bytes(text))
            try:
                read += len(penumbra.Recording(folder)) > 0
            except penumbra.Error as error:
                self.assertTrue(str(error).isprintable(), str(error))
                self.assertLess(len(str(error)), 700)
        self.assertGreater(read, 100)

    def test_that_were_cut_off_end_early(self):
        folder = self.write(HEADER + "0,0,frames/0.png\n1,1,frames/1.png\n2,2,fra", frames=2)
        recording = penumbra.Recording(folder)
        # A whole number of fields, but of a file that does not exist.
        self.assertEqual(len(recording), 2)
        self.assertIn("cut off after frame 1, 2 of 3 frames", recording.notices[0])
        (folder / "timestamps.csv").write_text(HEADER + "0,0,frames/0.png\n1,1")
        recording = penumbra.Recording(folder)
        self.assertEqual(len(recording), 1)
        self.assertIn("line 3 is cut off", recording.notices[0])
        (folder / "timestamps.csv").write_text(HEADER + "0,0,frames/0.png\n1,1,frames/9.png\n"
                                               "2,2,frames/1.png\n")
        self.assert_fails(penumbra.Error, "9.png: is listed but missing", penumbra.Recording,
                          folder)
        (folder / "timestamps.csv").write_text(HEADER + "0,0,frames/0.png\n1,1,frames/1.png\n")
        whole = (folder / "frames" / "1.png").read_bytes()
        (folder / "frames" / "1.png").write_bytes(whole[: len(whole) // 2])
        recording = penumbra.Recording(folder)
        self.assertEqual(len(list(recording)), 1)
        self.assertIn("cut off after frame 0, 1 of 2 frames", recording.notices[0])
        (folder / "timestamps.csv").write_text(HEADER + "0,0,frames/9.png\n")
        self.assert_fails(penumbra.Error, "none of the 1 listed frames", penumbra.Recording, folder)

    def test_damaged_images_are_skipped_only_in_recordings_of_live(self):
        folder = self.write(HEADER + "".join(f"{i},{i},frames/{i}.png\n" for i in range(3)))
        (folder / "frames" / "1.png").write_bytes(b"no image")
        recording = penumbra.Recording(folder)
        self.assert_fails(penumbra.Error, "1.png", lambda: list(recording))
        (folder / "controls.json").write_text("{}")
        recording = penumbra.Recording(folder)
        self.assertEqual([frame.number for frame in recording], [0, 2])
        self.assert_fails(penumbra.Error, "1.png", lambda: recording[1])
        (folder / "camera.yaml").write_text("image_width: x")  # not a fault of a frame
        self.assert_fails(penumbra.Error, "camera.yaml", lambda: list(penumbra.Recording(folder)))

    def test_other_kinds_are_refused_with_a_remedy(self):
        fails = self.assert_fails
        fails(penumbra.Error, "is not a folder", penumbra.Recording, self.folder / "none")
        fails(penumbra.Error, "holds neither", penumbra.Recording, self.folder)
        video = self.folder / "video"
        video.mkdir()
        (video / "video.mkv").touch()
        (video / "timestamps.csv").write_text(HEADER + "0,0,video.mkv\n")
        fails(penumbra.Error, "video.mkv: is a video", penumbra.Recording, video)
        (self.folder / "euroc" / "mav0").mkdir(parents=True)
        fails(penumbra.Error, "EuRoC", penumbra.Recording, self.folder / "euroc")
        deep = self.write(HEADER + "0,0,frames/0.png\n", folder="deep")
        write_png(deep / "frames" / "0.png", np.full((4, 6), 1023), bits=16)
        fails(penumbra.Error, "0.png: has 16 bits per sample", lambda: penumbra.Recording(deep)[0])

    def test_padding_of_jpegs_is_cropped(self):
        folder = self.folder / "padded"
        shutil.copytree(TABLETOP, folder, ignore=lambda _, names: [n for n in names if n > "000003"
                                                                   and n.endswith(".jpg")])
        camera = (folder / "camera.yaml").read_text()
        self.assertIn("image_height: 480", camera)
        camera = camera.replace("image_height: 480", "image_height: 472")
        (folder / "camera.yaml").write_text(camera)
        lines = (folder / "timestamps.csv").read_text().splitlines()[:4]
        (folder / "timestamps.csv").write_text("\n".join(lines) + "\n")
        recording = penumbra.Recording(folder)
        tracker = penumbra.Tracker(recording.camera, recording.tags)
        found = [tracker.track(frame.image, frame.time_ns).table.pose for frame in recording]
        scene = self.folder / "empty.json"
        scene.write_text('{"objects": []}')
        run("replay", folder, "--no-window", "--scene", scene, "--poses", self.folder / "poses.tum")
        expected = penumbra.Trajectory.load(self.folder / "poses.tum")
        self.assertEqual(len(expected), 3)
        self.assert_same_bits(np.array([pose.position for pose in found]), expected.positions)

    def test_of_simulate_have_groups(self):
        files = sorted(Path(shared_recording("tabletop")).glob("groundtruth.tum"))
        folder = self.write(HEADER + "0,0,frames/0.png\n")
        (folder / "groups").mkdir()
        shutil.copy(files[0], folder / "groups" / "prop.tum")
        truth = penumbra.Recording(folder).group_groundtruth
        self.assertEqual(list(truth), ["prop"])
        self.assertEqual(len(truth["prop"]), 120)


if __name__ == "__main__":
    unittest.main()
