"""What is written on a picture: title, time, distance, energy, and a legend of the colours."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from caterpillar_env.arrays import Array
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import Progress, label

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

CONTACT_RGB = (1.0, 0.55, 0.05)  #: feet on the ground, and the spots where anything touches it
PATH_RGB = (0.55, 0.15, 0.60)

_COLD = np.array([0.10, 0.35, 0.95])
_WARM = np.array([0.98, 0.85, 0.20])
_HOT = np.array([0.92, 0.10, 0.08])
_INK, _ALARM, _PANEL = (30, 30, 30), (190, 20, 20), (255, 255, 255, 185)


class Readout(NamedTuple):
    """What is written on a picture."""

    time_s: float  #: simulated
    distance_m: float  #: of the centre of mass along the starting heading
    energy_j: float  #: electrical
    failure: str = "ok"  #: name of the failure
    title: str = ""

    @classmethod
    def of(cls, progress: Progress, row: int = 0) -> Readout:
        """What is told of one of R robots."""
        return cls(
            float(progress.time_s[row]),
            float(progress.distance_m[row]),
            float(progress.energy_j[row]),
            label(progress.failure[row]),
        )


def spring_rgb(spring: SmaSpring, temperature_c: Array) -> Array:
    """Blue at ambient, yellow where austenite forms (As), red at the cut-off: (n,) to (n, 3)."""
    share = np.interp(
        temperature_c, [spring.ambient_c, spring.austenite_start_c, spring.cut_off_c], [0.0, 0.5, 1.0]
    )[:, None]
    colour: Array = np.where(
        share < 0.5, _COLD + 2 * share * (_WARM - _COLD), _WARM + (2 * share - 1) * (_HOT - _WARM)
    )
    return colour


def annotate(frame: NDArray[np.uint8], readout: Readout, spring: SmaSpring) -> NDArray[np.uint8]:
    """A picture (height, width, 3) with its readout in the left corner, the legend in the right one."""
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = max(11, min(image.height // 22, image.width // 30))
    pad = size // 2
    numbers = (
        f"{readout.time_s:4.1f} s    {1000 * readout.distance_m:+.0f} mm    {readout.energy_j:.0f} J"
    )
    legend = _legend(spring, max(10, round(0.8 * size)))
    shown = legend.width < 0.6 * image.width  # small pictures have no room for it
    room = max(image.width - legend.width * shown - 5 * pad, draw.textlength(numbers, _font(size)))
    title = _shortened(readout.title, _font(size), room)
    lines = [(text, _INK) for text in (title, numbers) if text]
    if readout.failure != "ok":
        lines.append((f"{readout.failure} at {readout.time_s:.1f} s", _ALARM))
    width = max(draw.textlength(text, _font(size)) for text, _ in lines)
    box = (pad, pad, 3 * pad + width, 2 * pad + len(lines) * 1.35 * size)
    draw.rounded_rectangle(box, radius=pad, fill=_PANEL)
    for number, (text, colour) in enumerate(lines):
        draw.text((2 * pad, 1.5 * pad + number * 1.35 * size), text, fill=colour, font=_font(size))
    if shown:
        image.paste(legend, (image.width - legend.width - pad, pad), legend)
    return np.asarray(image)


def _shortened(text: str, font: Font, room: float) -> str:
    """As much of a text as there is room for, px."""
    if font.getlength(text) <= room:
        return text
    kept = len(text)
    while kept and font.getlength(f"{text[:kept]}...") > room:
        kept -= 1
    return f"{text[:kept]}..."


@lru_cache(maxsize=32)
def _font(size: int) -> Font:
    return ImageFont.load_default(size)


@lru_cache(maxsize=32)
def _legend(spring: SmaSpring, size: int) -> Image.Image:
    """Scale of the springs' temperature, and what spots and line mean, in letters of `size` pixels."""
    image = Image.new("RGBA", (17 * size, round(5.3 * size)))
    draw = ImageDraw.Draw(image)
    right, bottom = image.width - 1, image.height - 1
    draw.rounded_rectangle((0, 0, right, bottom), radius=size // 2, fill=_PANEL)
    left, bar = 1.2 * size, 14.6 * size
    top = 1.7 * size
    draw.text((left, 1.4 * size), "springs", fill=_INK, font=_font(size), anchor="ls")
    span_c = spring.cut_off_c - spring.ambient_c
    pixels = np.linspace(spring.ambient_c, spring.cut_off_c, round(bar))
    for x, rgb in enumerate(spring_rgb(spring, pixels)):
        draw.line((left + x, top, left + x, top + 0.6 * size), fill=tuple((255 * rgb).astype(int)))
    for temperature_c, unit in (
        (spring.ambient_c, ""), (spring.austenite_start_c, ""), (spring.cut_off_c, " °C"),
    ):  # fmt: skip
        tick = left + bar * (temperature_c - spring.ambient_c) / span_c
        draw.line((tick, top, tick, top + 0.9 * size), fill=_INK)
        anchor = "rt" if unit else "mt"
        at = (right - 0.4 * size if unit else tick, top + 1.05 * size)
        draw.text(at, f"{temperature_c:.0f}{unit}", fill=_INK, font=_font(size), anchor=anchor)
    y = 4.45 * size
    spot, line = (tuple(round(255 * c) for c in rgb) for rgb in (CONTACT_RGB, PATH_RGB))
    draw.ellipse((left, y - 0.35 * size, left + 0.7 * size, y + 0.35 * size), fill=spot)
    draw.text((left + 1.1 * size, y), "on the ground", fill=_INK, font=_font(size), anchor="lm")
    dash = left + 9.6 * size
    draw.line((dash, y, dash + 1.2 * size, y), fill=line, width=max(2, size // 5))
    draw.text((dash + 1.6 * size, y), "path", fill=_INK, font=_font(size), anchor="lm")
    return image
