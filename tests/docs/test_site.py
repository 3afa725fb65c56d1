"""Every page is in the site's list, every page listed exists, and every link between pages leads somewhere."""

import json
import re
import unicodedata
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks/results"
PAGES = sorted((ROOT / "docs").glob("*.md"))
MADE = {"index.md", "changelog.md"}  # by docs/site_pages.py, as is what lies in reference/
_LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


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


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CHANGELOG.md", *PAGES], ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    links = [(page.parent / to if to else page, anchor) for to, anchor in _LINK.findall(page.read_text()) if "://" not in to]
    assert [str(to) for to, _ in links if not to.exists()] == []
    assert [f"{to.name}#{anchor}" for to, anchor in links if anchor and to.suffix == ".md" and anchor not in _anchors(to)] == []


def _anchors(page: Path) -> set[str]:
    """Headings as python-markdown makes anchors of them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    words = (unicodedata.normalize("NFKD", heading).encode("ascii", "ignore").decode() for heading in headings)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", text).strip().lower()) for text in words}


@pytest.mark.parametrize("results", sorted(RESULTS.glob("*.json")), ids=lambda p: p.stem)
def test_tables_and_notes_have_what_the_page_of_a_results_file_shows(results: Path) -> None:
    """docs/site_pages.py makes a page of each; a file of another form ends the building of the site."""
    found = json.loads(results.read_text())
    if not isinstance(found, dict):
        return
    for table in found.get("tables", []):
        assert table["section"]
        assert {len(row) for row in table["rows"]} <= {len(table["columns"])}
    assert all(note.keys() == {"section", "text"} for note in found.get("notes", []))
