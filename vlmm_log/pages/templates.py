"""The page that a template makes. What comes from logs is escaped."""

from __future__ import annotations

from collections.abc import Mapping


def rendered(name: str, values: Mapping[str, object]) -> str:
    """HTML of a template in vlmm_log/data."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("vlmm_log", "data"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(name).render(values)
