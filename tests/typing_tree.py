"""Build ``.typing/``: links that show the three folders as one package to mypy and pyright."""

import shutil
from pathlib import Path

ROOT = Path(__file__).parent.parent


def main() -> None:
    """Build it anew."""
    tree = ROOT / ".typing"
    shutil.rmtree(tree, ignore_errors=True)
    package = tree / "multirod"
    package.mkdir(parents=True)
    for file in (ROOT / "multirod").iterdir():
        if file.name != "__pycache__":
            (package / file.name).symlink_to(file)
    for folder in ("models", "solvers"):
        (package / folder).symlink_to(ROOT / folder)


if __name__ == "__main__":
    main()
