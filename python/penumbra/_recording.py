"""Recordings: folders with camera.yaml, tags.yaml, timestamps.csv and frames/ (docs/files.md)."""

import copy
import functools
import operator
import os.path  # which returns False where pathlib raises, such as for a name that is too long
import re
from dataclasses import dataclass, field
from decimal import ROUND_HALF_UP, Context, Decimal
from pathlib import Path, PurePosixPath
from typing import Optional

import numpy as np

from ._penumbra import CameraModel, Error, TagMap, Trajectory, load_image

_HEADER = "frame,timestamp_s,file"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_MAX_FRAME_DIGITS = 9
_MAX_LISTING_BYTES = 256_000_000
_MAX_TIME_NS = 4 * 10**18
_MAX_EXPOSURE_S = 60.0
_NANOSECOND = Decimal("1e-9")
_DECIMALS = Context(prec=60)  # not that of the caller
_PADDING_LINES = 16  # encoders fill up to whole blocks
_MAX_SHOWN = 200  # characters
_PNG = b"\x89PNG"


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a recording. Immutable.

    number: number of the frame in the listing.
    time_ns: time at the middle of the exposure [ns].
    exposure_s: exposure time [s], or None if unknown.
    wall_time_ns: the same time on the wall clock [ns since 1970, UTC], or None if unknown.
    file: path of the image file.
    image: read-only uint8 array: of a JPEG the luma, shape (height, width); of a PNG grey values or
        RGB, shape (height, width, 3).
    """

    number: int
    time_ns: int
    exposure_s: Optional[float]
    wall_time_ns: Optional[int]
    file: Path
    image: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class _Row:
    number: int
    time_ns: int
    exposure_s: Optional[float]
    wall_time_ns: Optional[int]
    file: Path


class Recording:
    """A recording: an iterator of frames with times, and the files beside them.

    Iterating yields each Frame, decoded when it is needed. len(), an index and a slice work as for
    a list; a slice is a Recording of these frames. Reads the recordings of `penumbra live` and
    `penumbra simulate` whose frames are images. Raises Error for video.mkv, EuRoC folders and
    16-bit images. Damaged images of `live` are skipped, as `penumbra replay` does.
    """

    def __init__(self, folder, *, camera_name=""):
        """folder: of the recording. camera_name: selects one of several cameras in camera.yaml.

        Raises Error if the folder is no recording, or for a line of timestamps.csv that is wrong.
        """
        self.folder = Path(folder)
        self._camera_name = camera_name
        self._notices = []
        self._check_kind()
        self._rows = self._drop_incomplete(_Listing(self.folder, self._notices).rows)
        # `live` skips damaged images, and so does `replay` of its recordings.
        self._skips_damaged = os.path.exists(self.folder / "controls.json")

    def _check_kind(self):
        folder = self.folder
        if not os.path.isdir(folder):
            raise Error(f"{folder}: is not a folder; a recording is a folder with frames/")
        if os.path.exists(folder / "timestamps.csv") or os.path.isdir(folder / "frames"):
            if not os.path.isdir(folder / "frames") and os.path.exists(folder / "video.mkv"):
                raise Error(
                    f"{folder / 'video.mkv'}: is a video, which the Python module does not read; "
                    "extract its frames to frames/ (ffmpeg -i video.mkv -vf extractplanes=y "
                    "-fps_mode passthrough -start_number 0 frames/%06d.png) and name them in the "
                    "column file of timestamps.csv, or record with live --format mjpeg"
                )
            return
        if os.path.isdir(folder / "mav0"):
            raise Error(
                f"{folder}: is an EuRoC folder, which the Python module does not read; list its "
                f"images in a timestamps.csv ({_HEADER})"
            )
        raise Error(f"{folder}: holds neither frames/ nor timestamps.csv; is it a recording?")

    def _drop_incomplete(self, rows):
        """Drops missing or damaged images at the end, which a crash leaves."""
        listed = len(rows)
        first_cause = ""
        while rows and (cause := _damage_of(rows[-1].file)):
            first_cause = first_cause or cause
            rows.pop()
        if not rows:
            raise Error(f"{first_cause}; none of the {listed} listed frames can be decoded")
        for row in rows:
            if not os.path.isfile(row.file):
                raise Error(
                    f"{_shown(row.file)}: is listed but missing, and later frames exist; restore "
                    "it, or remove its line from timestamps.csv"
                )
        if len(rows) < listed:
            self._notices.append(
                f"{self.folder}: cut off after frame {rows[-1].number}, {len(rows)} of {listed} "
                f"frames ({first_cause})"
            )
        return rows

    @functools.cached_property
    def camera(self):
        """The CameraModel of camera.yaml. Raises Error if there is none."""
        return CameraModel.load(self.folder / "camera.yaml", self._camera_name)

    @functools.cached_property
    def tags(self):
        """The TagMap of tags.yaml. Raises Error if there is none."""
        return TagMap.load(self.folder / "tags.yaml")

    @functools.cached_property
    def groundtruth(self):
        """Trajectory of true poses T_table_camera, or None if the recording has none."""
        file = self.folder / "groundtruth.tum"
        return Trajectory.load(file) if os.path.exists(file) else None

    @functools.cached_property
    def group_groundtruth(self):
        """True poses T_table_group by the name of the group, of groups that have any."""
        files = sorted((self.folder / "groups").glob("*.tum"))
        return {file.stem: Trajectory.load(file) for file in files}

    @property
    def notices(self):
        """What is unusual about the recording, such as missing frames at its end."""
        return list(self._notices)

    @functools.cached_property
    def _height(self):
        has_camera = os.path.exists(self.folder / "camera.yaml")
        return self.camera.height if has_camera else None

    def __len__(self):
        return len(self._rows)

    def __iter__(self):
        for row in self._rows:
            try:
                frame = self._decode(row)
            except Error:
                if self._skips_damaged and _damage_of(row.file):
                    continue
                raise
            yield frame

    def __getitem__(self, index):
        if isinstance(index, slice):
            part = copy.copy(self)
            part._rows = self._rows[index]
            return part
        return self._decode(self._rows[operator.index(index)])

    def __repr__(self):
        return f"<penumbra.Recording {self.folder} of {len(self)} frames>"

    def _decode(self, row):
        image = load_8_bit_image(row.file)
        height = self._height
        if height is not None and height < image.shape[0] < height + _PADDING_LINES:
            if _first_bytes(row.file)[:4] != _PNG:
                image = image[:height]  # hardware encoders pad JPEGs at the bottom
        return Frame(
            row.number, row.time_ns, row.exposure_s, row.wall_time_ns, row.file, image
        )


class _Listing:
    """Reads timestamps.csv; docs/files.md describes it."""

    def __init__(self, folder, notices):
        self.folder = folder
        self.csv = folder / "timestamps.csv"
        self.rows = []
        try:
            if self.csv.stat().st_size > _MAX_LISTING_BYTES:
                raise Error(
                    f"{self.csv}: has more than {_MAX_LISTING_BYTES} bytes; is it a listing?"
                )
            text = self.csv.read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            raise Error(
                f"{self.csv}: no such file; a recording needs it, with the lines {_HEADER}"
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise Error(f"{self.csv}: cannot be read: {error}") from None
        lines = [(number, line.strip()) for number, line in enumerate(text.split("\n"), 1)]
        lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
        if not lines:
            raise Error(f"{self.csv}: is empty; its first line must be {_HEADER}")
        self.columns = _fields(lines[0][1])
        for name in ("frame", "timestamp_s", "file"):
            if name not in self.columns:
                raise Error(
                    f"{self.csv}: line {lines[0][0]}: has no column {name}; the first line must be "
                    f"{_HEADER}"
                )
        for number, line in lines[1:]:
            fields = _fields(line)
            cut = number == lines[-1][0] and not text.endswith("\n")
            # Its last digits may be missing.
            if cut and self.columns[-1] == "wall_time_ns" and len(fields) == len(self.columns):
                fields[-1] = ""
            try:
                self._add(f"{self.csv}: line {number}: ", fields)
            except Error:
                # After a crash the listing may end in the middle of a line.
                if not cut or not self.rows:
                    raise
                notices.append(f"{self.csv}: line {number} is cut off and skipped")
        if not self.rows:
            raise Error(f"{self.csv}: lists 0 frames; record again, or list the frames there are")

    def _add(self, place, fields):
        if len(fields) != len(self.columns):
            raise Error(
                f"{place}has {len(fields)} fields; the first line names {len(self.columns)}"
            )
        values = dict(zip(self.columns, fields))
        row = _Row(
            _frame_number(values["frame"], place),
            _time_ns(values["timestamp_s"], place),
            _exposure_s(values.get("exposure_s", ""), place),
            _wall_time_ns(values.get("wall_time_ns", ""), place),
            self.folder / _inside(values["file"], place),
        )
        if self.rows and row.number <= self.rows[-1].number:
            raise Error(
                f"{place}frame: {row.number} does not come after {self.rows[-1].number} of the "
                "line before; number frames in order"
            )
        if self.rows and row.time_ns <= self.rows[-1].time_ns:
            raise Error(
                f"{place}timestamp_s: {_shown(values['timestamp_s'])} s does not come after the "
                "time of the line before; times must grow"
            )
        self.rows.append(row)


def _shown(text):
    """Text of a file in a message: short and without control characters."""
    text = str(text)
    text = text if len(text) <= _MAX_SHOWN else "..." + text[-_MAX_SHOWN:]
    return "".join(c if c.isprintable() else "?" for c in text)


def _fields(line):
    return [part.strip() for part in line.split(",")]


def _frame_number(text, place):
    digits = text.lstrip("0")
    if not (re.fullmatch(r"\d+", text, re.ASCII) and len(digits) <= _MAX_FRAME_DIGITS):
        raise Error(f"{place}frame: {_shown(text)!r} is not a frame number (0, 1, 2, ...)")
    return int(digits or "0")


def _time_ns(text, place):
    """Nanoseconds, rounded half away from zero, as the program reads them."""
    try:
        time_ns = int(
            Decimal(text).quantize(_NANOSECOND, ROUND_HALF_UP, _DECIMALS).scaleb(9, _DECIMALS)
        )
        if _NUMBER.fullmatch(text) and abs(time_ns) <= _MAX_TIME_NS:
            return time_ns
    except (ArithmeticError, ValueError):
        pass  # no number, or far out of range
    raise Error(f"{place}timestamp_s: {_shown(text)!r} is not a finite number of seconds")


def _exposure_s(text, place):
    if not text:
        return None
    if _NUMBER.fullmatch(text) and 0.0 < float(text) <= _MAX_EXPOSURE_S:
        return float(text)
    raise Error(
        f"{place}exposure_s: {_shown(text)!r} is not a time above 0 and up to {_MAX_EXPOSURE_S:g} s"
    )


def _wall_time_ns(text, place):
    if not text:
        return None
    if re.fullmatch(r"-?\d{1,19}", text, re.ASCII) and -(2**63) <= int(text) < 2**63:
        return int(text)
    raise Error(
        f"{place}wall_time_ns: {_shown(text)!r} is not a whole number of nanoseconds since 1970 (UTC)"
    )


def _inside(text, place):
    path = PurePosixPath(text)
    if not text or "\0" in text or path.is_absolute() or ".." in path.parts:
        raise Error(f"{place}file: {_shown(text)!r} is not a path inside the recording")
    return path


def _damage_of(file):
    """Why the image cannot be decoded, or ''."""
    try:
        load_image(file)
    except Error as error:
        return str(error)
    return ""


def load_8_bit_image(file):
    """load_image() of an image whose values need no other scale."""
    head = _first_bytes(file)
    if head[:4] == _PNG and head[12:16] == b"IHDR" and head[24:25] == b"\x10":
        raise Error(
            f"{_shown(file)}: has 16 bits per sample, of which cameras often use only 10 to 14; "
            "store 8 bits, or use the program, which finds out how many are used"
        )
    return load_image(file)


def _first_bytes(file):
    try:
        with open(file, "rb") as stream:
            return stream.read(25)
    except OSError as error:
        raise Error(f"{_shown(file)}: cannot be read: {error.strerror}") from None
