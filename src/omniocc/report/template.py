"""Web pages from the templates beside this file; every value is escaped unless it is marked as safe."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

ENVIRONMENT = Environment(
    loader=PackageLoader("omniocc.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
ENVIRONMENT.policies["json.dumps_kwargs"] = {"separators": (",", ":")}  # keeps the order of keys


def render(name: str, content: dict[str, Any]) -> str:
    """Return a page.

    Args:
        name: file of the template.
        content: plain data by the names that the template uses.

    Raises:
        jinja2.UndefinedError: when the template uses a name that is missing.
    """
    return ENVIRONMENT.get_template(name).render(content)
