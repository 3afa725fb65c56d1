"""What the site has beyond docs/*.md: the README as its first page, the commands' own help, the keys of
the configuration, the measured tables, and the docstrings. A hook of mkdocs.

Formulas become MathML, which browsers draw by themselves.
"""

import ast
import json
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import BuildError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PACKAGES = ("estimator", "vision", "models", "calib", "logs")
_FETCHED = re.compile(r'<(?:script|img|iframe)\b[^>]* src="?(https?:[^" >]+)')
RESULTS = ROOT / "benchmarks" / "results"
_RESULT = re.compile(r"\]\(\.\./benchmarks/results/(\w+)\.json\)")
_LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
_KEY = re.compile(r"(?:# )?(\w+) = *(.*?) *# (.*)")  # name, default (a key without one is a comment), what
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    pages = {
        "index.md": _of_root((ROOT / "README.md").read_text(encoding="utf-8")),
        "changelog.md": _of_root((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")),
        "reference/commands.md": commands(),
        "reference/configuration.md": configuration(),
        **{f"evidence/{path.stem}.md": evidence(path) for path in sorted(RESULTS.glob("*.json")) if _tables(path)},
        "reference/landfix.md": public(),
        **{f"reference/{package}.md": modules(package) for package in PACKAGES},
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to measured tables lead to their pages; those to other files of the repository become names."""
    markdown = _RESULT.sub(lambda m: f"](evidence/{m[1]}.md)" if _tables(RESULTS / f"{m[1]}.json") else m[0], markdown)
    return _LINK.sub(lambda m: m[1][1:-1] if m[2].startswith("../") else m[0], markdown)


def on_page_content(html: str, **_: Any) -> str:
    r"""Formulas between \( \) and \[ \] as MathML."""
    return _FORMULA.sub(_math, html)


@event_priority(-200)  # type: ignore[untyped-decorator,unused-ignore]  # behind the plugin `offline`
def on_post_build(config: Any) -> None:
    """The site works from a disk: its search index is a script, and no page loads anything from the network."""
    site = Path(config["site_dir"])
    if not (site / "search" / "search_index.js").is_file():
        raise BuildError("search/search_index.js is missing: is the plugin `offline` on?")
    for page in sorted(site.rglob("*.html")):
        if fetched := _FETCHED.search(page.read_text(encoding="utf-8")):
            raise BuildError(f"{page.relative_to(site)} loads {fetched[1]}")


def commands() -> str:
    """`landfix --help` and that of every command below it."""
    import typer  # noqa: PLC0415  (the help is asked for once, the other hooks run for each page)
    from typer.testing import CliRunner  # noqa: PLC0415

    from estimator.cli import app  # noqa: PLC0415

    def pages_of(words: list[str], group: Any, level: int) -> list[str]:
        text = CliRunner().invoke(app, [*words, "--help"], env={"NO_COLOR": "1", "TERM": "dumb"}, prog_name="landfix").output
        lines = [f"{'#' * min(level, 4)} {' '.join(['landfix', *words])}", "", "```text", text.strip("\n"), "```", ""]
        for name in sorted(getattr(group, "commands", {})):
            if not group.commands[name].hidden:
                lines += pages_of([*words, name], group.commands[name], level + 1)
        return lines

    return "\n".join(["# Commands", "*For whoever types them.*", "", *pages_of([], typer.main.get_command(app), 2)])


def configuration() -> str:
    """Every key with unit and default: what `landfix doctor --config --all` prints."""
    from typer.testing import CliRunner  # noqa: PLC0415  (as in commands)

    from estimator.cli import app  # noqa: PLC0415

    parts = ["# Configuration\n*For whoever writes a configuration file.*"]
    for line in CliRunner().invoke(app, ["doctor", "--config", "--all"]).stdout.splitlines():
        if line.startswith("["):
            parts.append(f"\n## `{line}`\n| key | default | what |\n|---|---|---|")
        elif key := _KEY.match(line):
            default = f"`{key[2]}`" if key[2] else ""
            parts.append(f"| `{key[1]}` | {default} | {key[3].replace('|', chr(92) + '|')} |")
    return "\n".join(parts) + "\n"


def evidence(path: Path) -> str:
    """The tables and notes of a results file."""
    parts = [f"# Measured: {path.stem}", f"*Data of `benchmarks/results/{path.name}`, for whoever checks a number.*"]
    for table in _tables(path):
        rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
        parts += [f"## {table['section']}", *filter(None, (table.get("command") and f"`{table['command']}`", table.get("note")))]
        parts += ["\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows)]
    notes = json.loads(path.read_text(encoding="utf-8")).get("notes", [])
    parts += ["## Notes", *(f"- *{note['section']}*: {note['text']}" for note in notes)] if notes else []
    return _LINK.sub(lambda m: m[1].lstrip("!")[1:-1], "\n\n".join(parts)) + "\n"


def _tables(path: Path) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return [table for table in found.get("tables", []) if table["columns"]]


def modules(package: str) -> str:
    """A package folder by folder: each folder's door, its `__init__`, goes first and says where to begin, then its modules."""
    folders = [p.parent for p in sorted((ROOT / package).rglob("__init__.py"), key=lambda p: p.parent.parts)]
    doors = "\n".join(f"| [{_name(folder)}][] | {_first_line(folder)} |" for folder in folders[1:])
    parts = [f"# {package}", _door(folders[0], 2)]
    if doors:
        parts += [f"| folder | what |\n|---|---|\n{doors}"]
    for folder in folders:
        parts += [_door(folder, 2)] if folder != folders[0] else []
        parts += [f"::: {_name(p.with_suffix(''))}\n    options:\n      heading_level: 3" for p in _modules_of(folder)]
    return "\n\n".join(parts) + "\n"


def public() -> str:
    """The names of `import landfix`, each with where it is described."""
    tree = ast.parse((ROOT / "landfix" / "__init__.py").read_text(encoding="utf-8"))
    names = [
        (alias.asname or alias.name, node.module)
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    rows = "\n".join(f"| `{name}` | [{module}][] |" for name, module in sorted(names))
    return f"# landfix\n\n{_door(ROOT / 'landfix', 2)}\n\n| name | described in |\n|---|---|\n{rows}\n"


def _modules_of(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*.py") if not p.name.startswith("_"))


def _name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).parts)


def _door(folder: Path, level: int) -> str:
    return f"::: {_name(folder)}\n    options:\n      heading_level: {level}\n      members: false"


def _first_line(folder: Path) -> str:
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].replace("|", "\\|")


def _of_root(text: str) -> str:
    """A page of the root as one of docs/: its links to docs/ lose the folder, others their targets."""

    def target(m: re.Match[str]) -> str:
        if m[2].startswith("docs/"):
            return f"{m[1]}({m[2].removeprefix('docs/')})"
        if m[2] == "CHANGELOG.md":
            return f"{m[1]}(changelog.md)"
        return m[0] if "://" in m[2] or m[2].startswith("#") else m[1][1:-1]

    return _LINK.sub(target, text)


def _math(m: re.Match[str]) -> str:
    r"""One formula; html's escapes are taken back."""
    source = m[2].strip().replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    block = source.startswith(r"\[")
    return str(convert(source[2:-2].strip(), display="block" if block else "inline"))
