"""What mkdocs calls while it builds the site (`hooks` in mkdocs.yml)."""

import sys
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pygments.formatters import HtmlFormatter

ROOT = Path(__file__).resolve().parents[2]
# mkdocs loads this file by its path, from anywhere
sys.path.append(str(ROOT))

from tools.pages import commands, equations  # noqa: E402

COMMANDS = "commands.md"
CODE_STYLE = "css/code.css"
REPORT = "reproduction/report.html"
"""Of `make reproduce`, where there is one: part of the site, with a link from its page."""


def on_files(files: Files, config: Any) -> Files:
    """Adds what is written by programs: the page of the commands, the colours of code."""
    colours = HtmlFormatter(style="default").get_style_defs(".highlight")
    files.append(File.generated(config, COMMANDS, content=commands.page()))
    files.append(File.generated(config, CODE_STYLE, content=colours))
    if (report := _report()) is not None:
        files.append(File.generated(config, REPORT, content=report))
    return files


def _report() -> bytes | None:
    made = ROOT / "runs" / "reproduce" / "report.html"
    return made.read_bytes() if made.is_file() else None


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Links the report where there is one."""
    if page.file.src_uri != "reproduction.md" or files.get_file_from_path(REPORT) is None:
        return markdown
    return markdown.replace("\nThe report is part", "\n[The report](reproduction/report.html) is part")


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Draws the equations of a page."""
    try:
        return equations.with_equations(html)
    except equations.EquationError as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from None
