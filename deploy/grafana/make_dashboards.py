"""Generator of the Grafana dashboards: `python -m deploy.grafana.make_dashboards`."""

import json
from pathlib import Path
from typing import Final

from deploy.grafana import disagreement, operation
from deploy.grafana.panels import dashboard_json

FOLDER: Final = Path(__file__).parent / "dashboards"


def made() -> dict[Path, str]:
    """Return the content of each file."""
    return {
        FOLDER / f"{name}.json": json.dumps(dashboard_json(dashboard), indent=1) + "\n"
        for name, dashboard in (
            ("disagreement", disagreement.DASHBOARD),
            ("operation", operation.DASHBOARD),
        )
    }


def main() -> None:
    """Write the files."""
    FOLDER.mkdir(exist_ok=True)
    for path, text in made().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
