"""The site: `make docs`. Pages stay plain Markdown that reads well without it; what only the site needs is added here."""

import re
from enum import IntEnum
from importlib import import_module
from pathlib import Path
from shutil import copyfile
from typing import Any, get_origin

import multirod as mr

HERE = Path(__file__).parent
LINK = re.compile(r"\]\(([\w/-]+)\.md\)")

project = "multirod"
author = "the authors of multirod"
copyright = author
version = release = mr.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
root_doc = "README"
html_theme = "furo"
html_title = f"multirod {release}"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_copy_source = False
html_show_sourcelink = False
nitpicky = True

myst_fence_as_directive = {"math"}  # as GitHub renders them: blocks marked as math
myst_heading_anchors = 4

nitpick_ignore = [("py:exc", "Interrupted")]  # raised inside the package only

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say what it is, in which shape and unit; annotations say array in most places
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_attr_annotations = False


def named(page: str) -> list[str]:
    """Names in the first column of the tables of a page of the reference; those with a dot are of a module of the package."""
    return re.findall(r"^\| `([\w.]+)`", page, flags=re.MULTILINE)


def public(thing: type) -> bool:
    """Whether a class is one that users name."""
    return thing.__name__ in mr.__all__


def directive(name: str) -> str:
    """What documents a public name from its docstring."""
    module, _, last = f"multirod.{name}".rpartition(".")
    thing = getattr(import_module(module), last)
    if not isinstance(thing, type):
        kind, option = ("function", "") if callable(thing) else ("data", "   :no-value:\n")
        return f".. auto{kind}:: multirod.{name}\n{option}"
    options = ["members"]
    options += ["undoc-members"] * issubclass(thing, IntEnum)
    options += ["show-inheritance"] * any(map(public, thing.__bases__))
    # from what has no entry
    inherits = thing in (mr.Solution, mr.BoundaryProblem) or (issubclass(thing, mr.Assembly) and thing is not mr.Assembly)
    options += ["inherited-members"] * inherits
    return f".. autoclass:: multirod.{name}\n" + "".join(f"   :{option}:\n" for option in options)


def contents(docname: str, page: str) -> str:
    """The sections of an index as a contents tree; what the first one does not name stands last in it."""
    folder = (HERE / docname).parent
    parts = {"": page.partition("\n## ")[0]} | dict(re.findall(r"^## (.*)\n((?:(?!## ).*\n)*)", page, flags=re.MULTILINE))
    listed = {title: [name for name in LINK.findall(body) if (folder / f"{name}.md").exists()] for title, body in parts.items()}
    if docname == root_doc:
        known = {name for names in listed.values() for name in names}
        listed["More"] = sorted(path.stem for path in HERE.glob("*.md") if path.stem not in known | {root_doc})
    return "".join(
        "\n```{toctree}\n:hidden:\n" + f":caption: {title}\n" * bool(title) + "\n" + "\n".join(names) + "\n```\n"
        for title, names in listed.items()
        if names
    )


def complete(app: object, docname: str, source: list[str]) -> None:
    """Add to a page what only the site needs."""
    if Path(docname).name == "README":
        source[0] += contents(docname, source[0])
    elif docname.startswith("reference/"):
        source[0] += "\n```{eval-rst}\n" + "\n".join(map(directive, named(source[0]))) + "```\n"


def only_public(app: object, name: str, thing: object, options: object, bases: list[type]) -> None:
    """Name the bases that users name, without their parameters."""
    bases[:] = [get_origin(base) or base for base in bases if public(base)]


def adapt(app: object, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Link pages, and keep what stands before a colon in the first line of a property from being taken for its type."""
    lines[:] = [re.sub(r"``docs/(\w+)\.md``", r":doc:`/\1`", line) for line in lines]
    if what in ("property", "attribute") and lines:
        lines[0] = lines[0].replace(": ", " \N{EN DASH} ", 1)


def plain(app: object, doctree: Any) -> None:
    """Leave out the annotations of properties and attributes: their docstrings have shape and unit."""
    from sphinx import addnodes

    for signature in doctree.findall(addnodes.desc_signature):
        for part in list(signature.findall(addnodes.desc_annotation)):
            if part.astext().startswith(":"):
                part.parent.remove(part)


def also_index(app: Any, error: Exception | None) -> None:
    """The first page under the name that servers look for."""
    if error is None and app.builder.format == "html":
        copyfile(Path(app.outdir) / f"{root_doc}.html", Path(app.outdir) / "index.html")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    for name in mr.__all__:  # documented as users call them, not where they stand
        getattr(mr, name).__module__ = "multirod"
    app.connect("source-read", complete)
    app.connect("autodoc-process-bases", only_public)
    app.connect("autodoc-process-docstring", adapt, priority=400)
    app.connect("doctree-read", plain)
    app.connect("build-finished", also_index)
