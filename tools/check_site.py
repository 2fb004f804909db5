"""Check a built site: links and pictures, no loading from the network, and how much there is to read.

Links, anchors and pictures exist, and pictures have a text. The sidebar holds at most 18 pages; all sources but those
of the engineering archive hold at most 30 000 words.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_REFERENCES = {"a": "href", "img": "src", "link": "href", "script": "src", "source": "srcset"}
_OURS = {"img", "link", "script", "source"}  # loaded with the page, so that they must not lie in the network
_PAGES, _WORDS = 18, 30_000
_GENERATED = re.compile(r"<!-- Written by .*?<!-- End -->", re.DOTALL)
"""Tables of a page that a tool makes: they are looked up, not read."""
_ARCHIVE = {"engineering", "adr"}


@dataclass
class Page(HTMLParser):
    """What a page refers to, and what may be referred to in it."""

    references: list[tuple[str, str]] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    silent: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep references, anchors, and pictures without a text."""
        given = dict(attrs)
        self.anchors |= {value for name in ("id", "name") if (value := given.get(name))}
        target = given.get(_REFERENCES.get(tag, ""))
        if target and given.get("rel") != "canonical":
            self.references.append((tag, target))
        text = (given.get("alt") or "").strip()
        if tag == "img" and (not text or text.endswith(".png")):
            self.silent.append(given.get("src") or "")


def read(file: Path) -> Page:
    """Parse a page."""
    page = Page()
    page.feed(file.read_text(encoding="utf-8"))
    return page


def findings(site: Path) -> list[str]:
    """Return a sentence for each fault of a site."""
    pages = {file.resolve(): read(file) for file in sorted(site.rglob("*.html"))}
    found = []
    for file, page in pages.items():
        name = file.relative_to(site.resolve())
        found += [f"{name}: the picture {source} has no alternative text." for source in page.silent]
        for tag, reference in page.references:
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                if tag in _OURS and parts.scheme != "data":
                    found.append(f"{name}: {reference} is loaded from the network.")
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            if not target.exists():
                found.append(f"{name}: the link {reference} leads nowhere.")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{name}: the link {reference} names an anchor that is not there.")
    return found


def excess(site: Path) -> list[str]:
    """Return a sentence if the sidebar has too many pages, and one if there are too many words outside the archive."""
    sidebar = (
        (site / "index.html").read_text(encoding="utf-8").partition('class="sidebar-tree"')[2].partition("</aside>")[0]
    )
    pages = set(re.findall(r'href="([^"#]+)"', sidebar))
    sources = [
        file for file in (site / "_sources").rglob("*.md.txt") if _ARCHIVE.isdisjoint(file.relative_to(site).parts)
    ]
    words = sum(len(_GENERATED.sub("", file.read_text(encoding="utf-8")).split()) for file in sources)
    sys.stdout.write(f"{len(pages)} pages in the sidebar, {words} words outside the engineering archive.\n")
    return [
        f"There are {count} {what}, more than {most}: merge or move some into the engineering archive."
        for count, most, what in (
            (len(pages), _PAGES, "pages in the sidebar"),
            (words, _WORDS, "words outside the archive"),
        )
        if count > most or not count
    ]


def main() -> None:
    """Print what is wrong, and fail if anything is."""
    site = Path(sys.argv[1])
    found = findings(site) + excess(site)
    sys.stderr.writelines(f"{sentence}\n" for sentence in found)
    raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
