"""Text on frames: title, time, distance, energy, and a legend of the colours."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from caterpillar_env.arrays import Array
from caterpillar_env.sma import SmaSpring

_COLD = np.array([0.10, 0.35, 0.95])
_WARM = np.array([0.98, 0.85, 0.20])
_HOT = np.array([0.92, 0.10, 0.08])
_LONGEST = "30.0 s    +000 mm    000 J"  # the readouts of most robots are at most this wide
_INK, _ALARM, _PANEL = (30, 30, 30), (190, 20, 20), (255, 255, 255, 185)


class Readout(NamedTuple):
    """Numbers and text written on a frame."""

    time_s: float  #: simulated time
    distance_m: float  #: displacement of the centre of mass along the initial heading
    energy_j: float  #: electrical energy
    failure: str = "ok"  #: name of the failure
    title: str = ""


def spring_rgb(spring: SmaSpring, temperature_c: Array) -> Array:
    """Return colours (n, 3) for temperatures (n,): blue at ambient, yellow at As, red at the cut-off."""
    share = np.interp(
        temperature_c, [spring.ambient_c, spring.austenite_start_c, spring.cut_off_c], [0.0, 0.5, 1.0]
    )[:, None]
    colour: Array = np.where(
        share < 0.5, _COLD + 2 * share * (_WARM - _COLD), _WARM + (2 * share - 1) * (_HOT - _WARM)
    )
    return colour


def annotate(frame: NDArray[np.uint8], readout: Readout, spring: SmaSpring) -> NDArray[np.uint8]:
    """Return `frame` (height, width, 3) with the readout at the upper left and a legend at the right."""
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = max(11, min(image.height // 22, image.width // 30))
    font, pad = _font(size), size // 2
    room = image.width - 5 * pad
    legend = _legend(spring, max(10, round(0.8 * size)))
    if legend.width + font.getlength(_LONGEST) <= room:  # omit the legend in small frames
        image.paste(legend, (image.width - legend.width - pad, pad), legend)
        room -= legend.width
    numbers = (
        f"{readout.time_s:4.1f} s    {1000 * readout.distance_m:+.0f} mm    {readout.energy_j:.0f} J"
    )
    title = readout.title
    while font.getlength(title) > max(room, font.getlength(numbers)):
        title = title.removesuffix("...")[:-1] + "..."
    lines = [(text, _INK) for text in (title, numbers) if text]
    if readout.failure != "ok":
        lines.append((f"{readout.failure} at {readout.time_s:.1f} s", _ALARM))
    width = max(font.getlength(text) for text, _ in lines)
    box = (pad, pad, 3 * pad + width, 2 * pad + len(lines) * 1.35 * size)
    draw.rounded_rectangle(box, radius=pad, fill=_PANEL)
    for number, (text, colour) in enumerate(lines):
        draw.text((2 * pad, 1.5 * pad + number * 1.35 * size), text, fill=colour, font=font)
    return np.asarray(image)


@lru_cache(maxsize=32)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


@lru_cache(maxsize=32)
def _legend(spring: SmaSpring, size: int) -> Image.Image:
    """Draw the temperature scale of the springs with a font of `size` pixels."""
    image = Image.new("RGBA", (17 * size, round(4.0 * size)))
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
    return image
