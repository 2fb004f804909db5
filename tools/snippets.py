"""Write the Python of the pages that a user reads first as files, for type checkers: one file a page.

python tools/snippets.py FOLDER
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "docs/python.md", "docs/report.md")
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def main() -> None:
    """Write the files."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for page in PAGES:
        blocks = _BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))
        (folder / f"{Path(page).stem.lower()}_page.py").write_text("\n".join(blocks), encoding="utf-8")


if __name__ == "__main__":
    main()
