"""HTML pages from the templates of this package, each a single file without external resources."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jinja2

from caterpillar_env.errors import CaterpillarError


class PageError(CaterpillarError):
    """A page or one of its figures cannot be written."""


def render(template: str, filters: dict[str, Callable[..., str]], **contents: Any) -> str:
    """Render the text of a page.

    Args:
        template: name of a file of this package.
        filters: filters of the template by name, which format numbers.
        **contents: variables of the template; text in them is escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters |= filters
    return environment.get_template(template).render(**contents)


def data_url(kind: str, data: bytes) -> str:
    """Data of a media type (`kind`) as a URL, to embed it in a page."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
