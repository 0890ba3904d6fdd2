"""What HTML pages of one file share: their style, the 3D view, data in them, their policy."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

_FOLDER = Path(__file__).parent
STYLE = (_FOLDER / "page.css").read_text(encoding="utf-8")
WIREFRAME = (_FOLDER / "page.js").read_text(encoding="utf-8")
_HASHED = re.compile(r'<(script|style)(?: type="module")?>(.*?)</\1>', re.DOTALL)
_FIELD = re.compile(r"\{\{(\w+)\}\}")


def json_in_html(value: object) -> str:
    """JSON that is safe in a script element: its text can neither end the element nor open one."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026")


def in_base64(content: bytes) -> str:
    """Bytes as text."""
    return base64.b64encode(content).decode()


def filled(template: str, values: Mapping[str, str], allowed: Mapping[str, str]) -> str:
    """A page with its fields and its Content-Security-Policy, by which it loads nothing else.

    Args:
        template: HTML with a field `{{policy}}`, before all that come from outside.
        values: What stands in each other field `{{name}}`.
        allowed: What may be loaded or run besides the page's own scripts and styles, by directive.
    """
    # In one pass, so that a name that looks like a field stays a name.
    page = _FIELD.sub(lambda field: values.get(field[1], field[0]), template)
    policy = {"default-src": "'none'", "base-uri": "'none'", "form-action": "'none'", **allowed}
    for kind, content in _HASHED.findall(page):
        digest = in_base64(hashlib.sha256(content.encode()).digest())
        name = f"{kind}-src"
        policy[name] = f"{policy.get(name, '')} 'sha256-{digest}'".lstrip()
    stated = "; ".join(f"{name} {sources}" for name, sources in policy.items())
    return page.replace("{{policy}}", stated, 1)
