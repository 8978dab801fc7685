"""Pages of the site that do not lie in docs/: the changelog, the guide for contributors, and files that pages link to.

A link from a page to a file of the repository leads, on the site, to a page that shows the file. Listings that name
their file (```` ```python file=ferry.py ````) get it as their title.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)")
LISTING = re.compile(r"^(```\w+) file=(\S+)$", re.MULTILINE)
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
LANGUAGES = {".py": "python", ".toml": "toml"}


def _folder(page: str) -> str:
    """Folder in the repository of a page, given by its path on the site."""
    return "" if page in PAGES.values() and page != "index.md" else posixpath.join("docs", posixpath.dirname(page))


def _target(page: str, link: str) -> str:
    """Path in the repository that a link of a page leads to."""
    return posixpath.normpath(posixpath.join(_folder(page), link))


def _on_site(target: str) -> str:
    """Path on the site of a file or folder of the repository."""
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    return PAGES.get(target) or f"source/{target}{'/index' if (ROOT / target).is_dir() else ''}.md"


def _shown(target: str) -> dict[str, str]:
    """Pages that show a file of the repository, or the modules of a folder: path on the site -> Markdown."""
    path = ROOT / target
    head = f"---\nsearch: {{ exclude: true }}\n---\n\n# {target}\n\n"
    if not path.is_dir():
        text = path.read_text(encoding="utf-8")
        return {_on_site(target): f"{head}``````{LANGUAGES.get(path.suffix, 'text')}\n{text}\n``````\n"}
    modules = sorted(file.name for file in path.glob("*.py"))
    index = head + "\n".join(f"- [{name}]({name}.md)" for name in modules) + "\n"
    pages = {_on_site(target): index}
    for name in modules:
        pages |= _shown(f"{target}/{name}")
    return pages


def on_files(files: Files, config: Any) -> Files:
    """Add the changelog, the guide for contributors, and a page for each file that is linked to."""
    texts = {file.src_uri: file.content_string for file in files.documentation_pages()}
    own = {PAGES[name]: (ROOT / name).read_text(encoding="utf-8") for name in PAGES if name != "README.md"}
    shown: dict[str, str] = {}
    for page, text in (texts | own).items():
        for link in LINK.findall(text):
            target = _target(page, link)
            if not target.startswith("docs/") and target not in PAGES and (ROOT / target).exists():
                shown |= _shown(target)
    for page, text in (own | shown).items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links out of docs/ to pages of the site, and give listings their titles."""
    here = page.file.src_uri
    if here.startswith("source/"):
        return markdown

    def lead(match: re.Match[str]) -> str:
        target = _target(here, match[1])
        return posixpath.relpath(_on_site(target), posixpath.dirname(here)) if (ROOT / target).exists() else match[1]

    return LISTING.sub(r'\1 title="\2"', LINK.sub(lead, markdown))
