# SPDX-License-Identifier: BSD-3-Clause
"""What the pages say exists; that they build without a warning is for ``make docs``."""

import importlib.util
import pkgutil
import re
import shlex
from pathlib import Path

import click
import pytest
import typer
import yaml

import magmatch
from magmatch.cli.main import build_app

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
# A file or a folder of the package as pages name it, from its room on; pages of the theory leave out the folders
# that their line "Code:" names.
SOURCE = re.compile(r"`((?:[a-z_0-9]+/)*[a-z_0-9]+(?:/|\.py))`")
PACKAGES = [ROOT / "src" / "magmatch", ROOT, *sorted(ROOT.glob("packages/*/src"))]
COMMANDS = typer.main.get_command(build_app())


def pages_of(nav):
    for entry in nav:
        target = next(iter(entry.values())) if isinstance(entry, dict) else entry
        yield from [target] if isinstance(target, str) else pages_of(target)


def plugin_names(plugin):
    return list(plugin) if isinstance(plugin, dict) else [plugin]


def shell_commands(text):
    """All calls of magmatch in blocks of shell commands, as words."""
    for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("magmatch "):
                yield shlex.split(line.split(" 2>&1 |")[0], comments=True)


def test_every_page_is_in_the_navigation_and_every_entry_is_a_page():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    pages = sorted(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))
    assert sorted(pages_of(settings["nav"])) == pages


def test_no_page_is_built_or_read_with_something_fetched():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    assert settings["theme"]["font"] is False
    assert not {"offline", "privacy"} & {name for plugin in settings["plugins"] for name in plugin_names(plugin)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_a_page_parse(page):
    for _, *words in shell_commands(page.read_text()):
        if words == ["--version"]:
            continue
        assert words[0] in COMMANDS.commands, words
        command = COMMANDS.commands[words[0]]
        try:
            command.make_context(words[0], words[1:])  # parses, runs nothing
        except click.UsageError as error:
            pytest.fail(f"{' '.join(words)}: {error.format_message()}")


@pytest.mark.parametrize(
    "page", [ROOT / "CONTRIBUTING.md", *sorted((DOCS / "theory").glob("*.md"))], ids=lambda page: page.name
)
def test_files_that_a_page_names_exist(page):
    text = page.read_text()
    code = re.search(r"^Code: (.*?)(?:\n\n|\. )", text, re.DOTALL | re.MULTILINE)
    own = [PACKAGES[0] / name for name in SOURCE.findall(code[1])] if code else []
    folders = [*PACKAGES, *(path if path.is_dir() else path.parent for path in own)]
    folders += [folder.parent for folder in folders[len(PACKAGES) :]]
    for name in SOURCE.findall(text):
        assert any((folder / name).exists() for folder in folders), name


def test_names_on_the_page_of_the_api_exist():
    text = (DOCS / "api.md").read_text()
    for name in re.findall(r"^::: (\S+)", text, re.MULTILINE) + re.findall(r"\(#(magmatch\.[\w.]+)\)", text):
        assert pkgutil.resolve_name(name) is not None


def hook_of(name):
    """A module that the pages are built with."""
    spec = importlib.util.spec_from_file_location(name, DOCS / "hooks" / f"{name}.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    return hook


def test_every_setting_of_preparation_has_its_sentence_on_the_page_of_the_api():
    pytest.importorskip("griffe", reason="extra docs")
    found = {name: meaning for name, *_, meaning in hook_of("settings_tables").rows("magmatch.PreparationConfig")}
    assert "`calibration.soft_iron`" in found
    assert all(found.values())
    assert len(set(found.values())) == len(found)


def test_every_equation_is_drawn():
    pytest.importorskip("latex2mathml", reason="extra docs")
    hook = hook_of("mathml")
    drawn = hook.on_page_content(r'<p><span class="arithmatex">\(a &lt; \sigma^2\)</span></p>')
    assert "arithmatex" not in drawn
    assert drawn.count("<math") == 1
    assert "\\" not in drawn
    with pytest.raises(hook.PluginError, match="cannot draw"):
        hook.on_page_content(r'<div class="arithmatex">\[\nosuchcommand\]</div>')


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_on_a_page_compiles(page):
    for block in re.findall(r"```python[^\n]*\n(.*?)```", page.read_text(), re.DOTALL):
        compile(block, page.name, "exec")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_that_a_page_takes_from_the_package_exist(page):
    for owner, name in re.findall(r"\bmm\.([A-Za-z_]+)(?:\.([a-z_]+))?", page.read_text()):
        thing = getattr(magmatch, owner)
        assert not name or hasattr(thing, name), f"mm.{owner}.{name}"
