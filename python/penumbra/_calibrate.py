"""calibrate(): a camera from images of a target."""

import os
from pathlib import Path

import numpy as np

from ._penumbra import ArgumentError, Calibrator, Error, Target
from ._recording import load_8_bit_image

_SUFFIXES = {".png", ".jpg", ".jpeg"}  # those that `penumbra calibrate` reads in a folder


def _files_in(folder):
    if not os.path.isdir(folder):
        raise Error(f"{folder}: is not a folder; give a folder or a list of images")
    try:
        files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise Error(f"{folder}: cannot be read: {error.strerror}") from None
    if not files and (folder / "frames").is_dir():
        return _files_in(folder / "frames")  # a recording
    if not files:
        raise Error(f"{folder}: holds no images; give a folder of PNG or JPEG files")
    return files


def calibrate(images, target, *, model=None, max_views=60):
    """Calibrates a camera from images of a target, as `penumbra calibrate` does with a folder.

    images: a folder of PNG and JPEG files, a recording, or an iterable of files and of uint8 arrays, of shape
        (height, width) or (height, width, 3) for RGB. Arrays are named images[0], images[1], ...
    target: a Target, or the file that describes it.
    model: 'plumb_bob', 'rational' or 'fisheye'; None: chosen by cross-validation.
    max_views: solves this number of the most different views.

    Returns a Calibration. Takes seconds to minutes; other Python threads run meanwhile, and Ctrl-C
    takes effect when it returns. An image
    without the target is listed in Calibration.views. Raises Error for a file that cannot be read,
    and with what the images lack.
    """
    if not isinstance(target, Target):
        target = Target.load(target)
    calibrator = Calibrator(target, model=model, max_views=max_views)
    # (height, width, 3) is one image in RGB; a stack of images that are 3 pixels wide is none.
    if isinstance(images, np.ndarray) and (images.ndim == 2 or images.shape[2:] == (3,)):
        raise ArgumentError("images: is a single image; give a list of images")
    if isinstance(images, (str, os.PathLike)):
        images = _files_in(Path(images))
    for index, image in enumerate(images):
        if isinstance(image, (str, os.PathLike)):
            calibrator.add(Path(image).name, load_8_bit_image(image))
        else:
            calibrator.add(f"images[{index}]", image)
    return calibrator.solve()
