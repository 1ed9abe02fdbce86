"""Pages: one HTML file each, from the templates of this package, that opens without a network."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jinja2

from caterpillar_env.errors import CaterpillarError


class PageError(CaterpillarError):
    """A page, or a figure of it, cannot be written."""


def render(template: str, filters: dict[str, Callable[..., str]], **contents: Any) -> str:
    """The text of a page.

    Args:
        template: a file of this package.
        filters: how its numbers are shown.
        **contents: what it shows; text in it is escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= filters
    return environment.get_template(template).render(**contents)


def data_url(kind: str, data: bytes) -> str:
    """Bytes of a media type as what an element of the page holds instead of an address."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
