"""Other Python threads run while the library computes, and objects refuse a second thread."""

import itertools
import subprocess
import sys
import threading
import time
import unittest

import numpy as np
import penumbra
from support import HELICOPTER, TABLETOP, TestCase, first_frame, tabletop_tracker


def ticks_during(function):
    """Runs the function in a thread. Returns the number of times that this thread ran meanwhile."""
    # A thread that holds the lock is not interrupted.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(100.0)
    try:
        begin, end = [], []

        def work():
            begin.append(time.perf_counter())
            try:
                function()
            finally:
                end.append(time.perf_counter())

        thread = threading.Thread(target=work)
        ticks = []
        thread.start()
        while not end:
            ticks.append(time.perf_counter())
            time.sleep(0)  # lets the other thread have the lock
        thread.join()
        return sum(begin[0] < tick < end[0] for tick in ticks)
    finally:
        sys.setswitchinterval(interval)


def corner_views(camera):
    """Points of a chessboard and their pixels in tilted views."""
    points = penumbra.Target.chessboard(9, 6, 0.03).points
    views = []
    for i in range(14):
        angle, tilt = 2.4 * i, 0.6
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
        K = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
        R = np.eye(3) + np.sin(tilt) * K + (1 - np.cos(tilt)) * K @ K
        p = points @ (np.diag([1.0, -1.0, -1.0]) @ R).T
        p += [0.05 * np.cos(1.3 * i), 0.04 * np.sin(1.7 * i), 0.5 + 0.02 * (i % 4)]
        pixels = camera.project(p)
        inside = ((pixels >= 0) & (pixels <= [639, 479])).all(axis=1)
        views.append(np.where(inside[:, np.newaxis], pixels, np.nan))
    return points, views


class InterpreterLock(TestCase):
    def test_detects_functions_that_hold_it(self):
        values = list(range(300_000, 0, -1))
        self.assertEqual(ticks_during(lambda: sorted(values, key=None)), 0)

    def test_is_released_while_computing(self):
        recording = penumbra.Recording(TABLETOP)
        camera = recording.camera
        image = first_frame().image
        model = penumbra.Model.load(HELICOPTER)
        points, views = corner_views(camera)
        truth = recording.groundtruth
        calibrator = penumbra.Calibrator(penumbra.Target.load(TABLETOP / "tags.yaml"))
        tracker, times = tabletop_tracker(mode="detect"), itertools.count()
        many_points = np.random.default_rng(1).uniform(-1, 1, (200_000, 3)) + [0, 0, 3]
        for name, function in {
            "Tracker.track": lambda: tracker.track(image, next(times)),
            "load_image": lambda: penumbra.load_image(TABLETOP / "frames" / "000000.jpg"),
            "shadow_layers": lambda: penumbra.shadow_layers(model, T_world_object=np.eye(4)),
            "make_kernels": lambda: penumbra.make_kernels(model),
            "Model.load": lambda: penumbra.Model.load(HELICOPTER),
            "calibrate_corners": lambda: penumbra.calibrate_corners(640, 480, points, views),
            "Calibrator.add": lambda: calibrator.add("image", image),
            "evaluate": lambda: penumbra.evaluate(camera, truth, truth),
            "CameraModel.project": lambda: camera.project(many_points),
        }.items():
            with self.subTest(name):
                # On a busy machine this thread may get no processor in time.
                ticks = 0
                for _ in range(20):
                    ticks = ticks or ticks_during(function)
                self.assertGreater(ticks, 0)

    def test_two_trackers_give_the_same_poses_in_parallel(self):
        frames = [(frame.image, frame.time_ns) for frame in penumbra.Recording(TABLETOP)[:10]]

        def poses(results):
            tracker = tabletop_tracker()
            results.extend(tracker.track(*frame).table.T_table_camera.tobytes() for frame in frames)

        alone, together = [], [[] for _ in range(3)]
        poses(alone)
        threads = [threading.Thread(target=poses, args=[results]) for results in together]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(together, [alone] * 3)


class DaemonThread(TestCase):
    def test_does_not_abort_the_end_of_the_interpreter(self):
        script = f"""
import threading, time
import penumbra
recording = penumbra.Recording({str(TABLETOP)!r})
tracker = penumbra.Tracker(recording.camera, recording.tags, mode="detect")
image = recording[0].image
tracked = threading.Event()
def track():
    time_ns = 0
    while True:
        tracker.track(image, time_ns)
        time_ns += 1
        tracked.set()
threading.Thread(target=track, daemon=True).start()
tracked.wait()
print("done")
"""
        for _ in range(3):
            done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                                  timeout=100)
            self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "done\n", ""))


class SecondThread(TestCase):
    def test_gets_an_error(self):
        calibrator = penumbra.Calibrator(penumbra.Target.load(TABLETOP / "tags.yaml"))
        tracker = tabletop_tracker(mode="detect")
        image = first_frame().image
        for name, call, text in [
            ("calibrator", lambda i: calibrator.add(f"image {i}", image), "calibrator: is in use"),
            ("tracker", lambda i: tracker.track(image, i), "tracker: is in use"),
        ]:
            with self.subTest(name):
                done, messages = [], []
                stop = threading.Event()

                def work():
                    i = 0
                    while not stop.is_set():
                        i += 1
                        try:
                            call(i)
                            done.append(i)
                        except penumbra.Error as error:
                            messages.append(str(error))

                thread = threading.Thread(target=work)
                thread.start()
                deadline = time.monotonic() + 60
                refused = []
                while not refused and time.monotonic() < deadline:
                    try:
                        call(0)  # a time that does not increase, if it gets through
                    except penumbra.Error as error:
                        if text in str(error):
                            refused.append(str(error))
                    time.sleep(0.001)
                stop.set()
                thread.join()
                self.assertTrue(refused)
                self.assertTrue(done)


if __name__ == "__main__":
    unittest.main()
