"""Every page is in the site's list, every page listed exists, and every link between pages leads somewhere."""

import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
MADE = {"index.md", "changelog.md"}  # by docs/site_pages.py, as is what lies in reference/
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def _listed(node: object) -> list[str]:
    if isinstance(node, str):
        return [node]
    return [page for child in (node.values() if isinstance(node, dict) else node) for page in _listed(child)]  # type: ignore[attr-defined]


def test_the_list_of_pages_is_whole_and_true() -> None:
    nav = YAML(typ="safe").load((ROOT / "mkdocs.yml").read_text())["nav"]
    own = [page for page in _listed(nav) if page not in MADE and not page.startswith("reference/")]
    assert sorted(own) == [page.name for page in PAGES]


def test_search_from_a_disk_loads_nothing_from_the_network() -> None:
    """The plugin `offline` loads a script of its own, unless one with iframe-worker in its name is given."""
    config = YAML(typ="safe").load((ROOT / "mkdocs.yml").read_text())
    assert "offline" in config["plugins"]
    (script,) = config["extra"]["polyfills"]
    assert "iframe-worker" in script
    assert (ROOT / "docs" / script).is_file()


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    links = [link for link in _LINK.findall(page.read_text()) if "://" not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []
