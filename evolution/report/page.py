"""Renders templates to HTML pages. Each page is a single file without external resources."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jinja2


def render(template: str, filters: dict[str, Callable[..., str]], **contents: Any) -> str:
    """Render the text of a page.

    Args:
        template: name of a file of this package.
        filters: functions that format numbers in the template, by name.
        **contents: variables of the template. Text in them is escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= filters
    return environment.get_template(template).render(**contents)


def data_url(kind: str, data: bytes) -> str:
    """Encode data of a media type (`kind`) as a URL, for embedding in a page."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
