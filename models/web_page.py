"""A stand-alone HTML page; text escaped, foreign scripts forbidden."""

import base64
import html
from collections.abc import Sequence
from hashlib import sha256
from typing import Final

Rows = Sequence[Sequence[str]]
Table = tuple[str, Sequence[str], Rows]  # title, header, rows

GOOD, USABLE, BAD = "good", "usable", "bad"  # classes of a verdict

STYLE: Final = """
:root { color-scheme: light dark; --ground: #fff; --panel: #f6f7f8; --text: #1d2125; --faint: #667079; --line: #d5dade;
  --good: #00795a; --usable: #8a6100; --bad: #b84500; }
@media (prefers-color-scheme: dark) { :root { --ground: #15181b; --panel: #1e2226; --text: #e4e7ea; --faint: #98a2ab;
  --line: #373d43; } }
@media print { :root { color-scheme: light; } }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 76em; margin: 1.5em auto 4em; padding: 0 1.2em; background: var(--ground);
  color: var(--text); }
h1 { font-size: 1.6em; margin: .2em 0; overflow-wrap: anywhere; }
h2 { font-size: 1.2em; margin: 2em 0 .5em; padding-top: .4em; border-top: 1px solid var(--line); break-after: avoid; }
h3 { font-size: 1em; margin: 1.2em 0 .3em; break-after: avoid; }
p { max-width: 52em; margin: .4em 0; }
table { border-collapse: collapse; margin: .4em 0 1.2em; font-variant-numeric: tabular-nums; }
td, th { padding: .2em 1.1em .2em 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line);
  overflow-wrap: anywhere; }
th { font-weight: 600; }
tr { break-inside: avoid; }
img { max-width: 100%; }
pre { background: var(--panel); padding: .8em 1em; overflow-x: auto; font-size: .85em; border-radius: .3em; }
.verdict { display: inline-block; font-size: 1.3em; color: #fff; padding: .25em .7em; border-radius: .3em;
  -webkit-print-color-adjust: exact; print-color-adjust: exact; }
.good { background: var(--good); } .usable { background: var(--usable); } .bad { background: var(--bad); }
.faint { color: var(--faint); }
.wide { overflow-x: auto; }
"""


def text(of: object) -> str:
    """Text as it stands on a page."""
    return html.escape(str(of))


def table(of: Table) -> str:
    """A titled table; nothing without rows."""
    title, header, rows = of
    if not rows:
        return ""
    head = "<tr>" + "".join(f"<th>{text(cell)}</th>" for cell in header) + "</tr>" if header else ""
    body = "".join("<tr>" + "".join(f"<td>{text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    heading = f"<h3>{text(title)}</h3>" if title else ""
    return f'{heading}<div class="wide"><table>{head}{body}</table></div>'


def verdict(word: str, colour: str) -> str:
    """One of GOOD, USABLE, BAD, in own words."""
    return f'<span class="verdict {colour}">{text(word)}</span>'


def image(alt: str, data: bytes, kind: str = "png") -> str:
    """An image inside the page."""
    return f'<img alt="{text(alt)}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def page(title: str, body: str, style: str = "", script: str = "") -> str:
    """The page; body: HTML; script: the only one that may run."""
    digest = base64.b64encode(sha256(script.encode()).digest()).decode()
    allowed = f"script-src 'sha256-{digest}'; " if script else ""
    policy = f"default-src 'none'; {allowed}style-src 'unsafe-inline'; img-src data:"
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{text(title)}</title>\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{STYLE}{style}</style>\n</head>\n<body>\n'
        f"{body}\n{f'<script>{script}</script>' if script else ''}\n</body>\n</html>\n"
    )
