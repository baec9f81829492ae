"""The picture that goes with a question: every object that is asked about, framed and with its
number.
"""

from __future__ import annotations

import cv2
import numpy as np

from drivers.operator.interfaces import Question, Shown
from drivers.operator.words import PICTURE_BYTES
from path.arrays import Image
from path.observations import Box

NOTHING = Question(
    0,
    0,
    (Shown(0, Box(8.0, 8.0, 8.0, 8.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0),),
)
"""A question about nothing, for a first picture before setpoints wait for it: the library's drawing
and its letters may have to come from the disk, for 0.4 s."""
_QUALITIES = (85, 60, 35)
_INK = (0, 0, 0)
_PAPER = (255, 255, 255)


def numbered(image: Image, question: Question) -> Image:
    """Return the image (h, w, 3) with a frame and a number for each object."""
    drawn = image.copy()
    for each in question.shown:
        left = round(each.box.x)
        top = round(each.box.y)
        right = round(each.box.x + each.box.w)
        bottom = round(each.box.y + each.box.h)
        for ink, width in ((_INK, 4), (_PAPER, 2)):
            cv2.rectangle(drawn, (left, top), (right, bottom), ink, width)
            above = left, max(24, top - 8)
            cv2.putText(
                drawn,
                str(each.number),
                above,
                cv2.FONT_HERSHEY_SIMPLEX,
                1.0,
                ink,
                2 * width,
            )
    return drawn


def pictured(image: Image, question: Question) -> bytes:
    """Return the numbered image as JPEG that goes into a datagram: the worse and the smaller the
    more there is in it.
    """
    drawn = numbered(image, question)
    while True:
        for quality in _QUALITIES:
            _, encoded = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if encoded.nbytes <= PICTURE_BYTES:
                return encoded.tobytes()
        drawn = np.ascontiguousarray(drawn[::2, ::2])
