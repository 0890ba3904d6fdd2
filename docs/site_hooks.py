"""What the site needs beyond the pages of docs/, as hooks of MkDocs: `make site`.

Pages are written for GitHub. Here their links to files outside docs/ lead to the repository, the
pictures among these are copied, and formulas become MathML, which browsers draw without a script.
"""

import html
import os
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

import deepmds_keras

ROOT = Path(__file__).parents[1]
# Files outside docs/ that are pages.
PAGES = {"README.md": "index.md", "THIRD_PARTY_NOTICES.md": "licences.md"}
# Where GitHub builds the site; elsewhere, links lead to the files of this checkout.
_REPOSITORY = os.environ.get("GITHUB_REPOSITORY")
_LIVE = ROOT / "build" / "live.html"  # of `deepmds live`, in the site if it is there
_PICTURES = (".jpg", ".png")
_LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")
_FORMULA = re.compile(r"\$`([^`]+)`\$")
_MARKED = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.+?)\\[)\]]</\1>', re.DOTALL)


def on_config(config):
    if _REPOSITORY:
        config.repo_url = f"https://github.com/{_REPOSITORY}"
        config.repo_name = _REPOSITORY
    return config


def on_files(files, config):
    names = sorted(deepmds_keras.__all__, key=lambda name: name.endswith("Error"))
    names = "\n\n".join(f"::: deepmds_keras.{name}" for name in names)
    files.append(File.generated(config, "api.md", content=f"# Python API\n\n{names}\n"))
    for source, page in PAGES.items():
        _copy(ROOT / source, page, files, config)
    if _LIVE.exists():
        _copy(_LIVE, "live.html", files, config)
    return files


def on_page_markdown(markdown, page, config, files):
    folder = Path(page.file.abs_src_path or ROOT).parent

    def link(match):
        target = Path(os.path.relpath(folder / match[1], ROOT)).as_posix()
        place = PAGES.get(target, target.removeprefix("docs/"))
        if not files.get_file_from_path(place):
            if not target.endswith(_PICTURES):
                files_at = f"{config.repo_url}/blob/main" if _REPOSITORY else ROOT.as_uri()
                return f"]({files_at}/{target}"
            _copy(ROOT / target, place, files, config)
        return f"]({place}"

    if page.file.src_uri == "live.md" and _LIVE.exists():
        markdown = markdown.replace("\n", "\n\n**[Open the page](live.html)**\n", 1)
    return _LINK.sub(link, _FORMULA.sub(r"$\1$", markdown))


def on_page_content(content, page, config, files):
    return _MARKED.sub(lambda match: _mathml(html.unescape(match[2]), match[1], page), content)


def _mathml(formula, element, page):
    drawn = convert(formula.strip(), display="inline" if element == "span" else "block")
    if "\\" in drawn:  # a command that the converter does not know shows as it is written
        name = page.file.src_uri
        raise PluginError(f"{name}: the site cannot draw the formula {formula.strip()!r}.")
    return drawn


def _copy(source, place, files, config):
    files.append(File.generated(config, place, abs_src_path=str(source)))
