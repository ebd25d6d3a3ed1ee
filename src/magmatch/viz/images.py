# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a registration as PNG and SVG files."""

from pathlib import Path
from tempfile import TemporaryDirectory

from magmatch.errors import ConfigurationError, import_extra
from magmatch.field.map import FieldMap
from magmatch.published.config import PublishedConfig
from magmatch.registration.result import RegistrationResult
from magmatch.viz.figures.draw import Figure, require_plotly
from magmatch.viz.figures.published_figures import published_figures
from magmatch.viz.view import view

KINDS = ("png", "svg")


def require_images() -> None:
    """Raise an error that names the extra, or the browser, where no figure can be written as an image."""
    import_extra("kaleido", "an image file", "images")
    try:
        require_plotly().Figure().to_image("svg")
    except Exception as error:  # of the browser, of which there may be none: many kinds
        msg = (
            f"an image file is drawn by Chrome or Chromium, which did not start ({type(error).__name__}); install it"
        )
        raise ConfigurationError(msg) from error


def registration_figures(
    base: FieldMap, target: FieldMap, result: RegistrationResult, published: PublishedConfig | None
) -> dict[str, Figure]:
    """Both surveys in the base's frame, and what the published method saw if it was that, by name."""
    figures = {"in-space": view(result, base, target)}
    return figures | (published_figures(base, target, result.links, published) if published is not None else {})


def write_images(folder: Path, figures: dict[str, Figure]) -> None:
    """Write each figure as NAME.png and NAME.svg into a folder, which is made; no file is ever half written."""
    from plotly.io import write_images as write

    folder.mkdir(exist_ok=True)
    with TemporaryDirectory(prefix=".magmatch-", dir=folder) as aside:
        files = [Path(aside) / f"{name}.{kind}" for name in figures for kind in KINDS]
        # Twice as many pixels as on a page, for print.
        write(fig=[figure for figure in figures.values() for _ in KINDS], file=files, width=1000, scale=2)
        for file in files:
            file.replace(folder / file.name)
