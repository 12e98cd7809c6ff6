"""Serve Label Studio, label an export in it as its pages do, and print what it exports as JSON.

As the usage page says: two settings, a local storage for the pictures, the interface, the tasks.
"""

import json
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import requests

TOKEN = secrets.token_hex(20)
PATIENCE_S = 150.0


def main(folder: Path) -> None:
    """Label the first track of each task as `both`."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    with tempfile.TemporaryDirectory() as data:
        environment = os.environ | {
            "LABEL_STUDIO_LOCAL_FILES_SERVING_ENABLED": "true",
            "LABEL_STUDIO_LOCAL_FILES_DOCUMENT_ROOT": str(folder),
            "LABEL_STUDIO_BASE_DATA_DIR": data,
            "LABEL_STUDIO_USERNAME": "labeller@lab.example",
            "LABEL_STUDIO_PASSWORD": secrets.token_hex(20),
            "LABEL_STUDIO_USER_TOKEN": TOKEN,
            "LABEL_STUDIO_ENABLE_LEGACY_API_TOKEN": "true",
            "COLLECT_ANALYTICS": "false",
            "LATEST_VERSION_CHECK": "false",
        }
        program = Path(sys.executable).with_name("label-studio")
        command = [str(program), "start", "--no-browser", "--port", str(port)]
        with (
            (Path(data) / "log").open("w") as log,
            subprocess.Popen(command, env=environment, stdout=log, stderr=log) as server,
        ):
            try:
                json.dump(label(f"http://127.0.0.1:{port}", folder, server), sys.stdout)
            finally:
                server.terminate()


def label(url: str, folder: Path, server: "subprocess.Popen[bytes]") -> dict[str, Any]:
    """Make a project of an export, label it, and export it again."""
    session = requests.Session()
    session.headers["Authorization"] = f"Token {TOKEN}"
    until_up(url, session, server)

    def ask(verb: str, path: str, **fields: Any) -> requests.Response:
        answer = session.request(verb, url + path, timeout=60, **fields)
        assert answer.ok, f"{verb} {path}: {answer.status_code} {answer.text[:500]}"
        return answer

    interface = (folder / "config.xml").read_text()
    made = ask("POST", "/api/projects", json={"title": "the week", "label_config": interface})
    project = made.json()["id"]
    storage = {"project": project, "path": str(folder / "images"), "use_blob_urls": True}
    ask("POST", "/api/storages/localfiles", json=storage)
    tasks = {"file": ("tasks.json", (folder / "tasks.json").read_bytes(), "application/json")}
    imported = ask("POST", f"/api/projects/{project}/import", files=tasks).json()
    listed = ask("GET", "/api/tasks", params={"project": project, "fields": "all"}).json()["tasks"]
    pictures = []
    for task in listed:
        picture = ask("GET", task["data"]["image"])
        pictures.append(picture.headers["content-type"])
        chosen = {"from_name": "wrong_0", "to_name": "image", "type": "choices"}
        result = [chosen | {"value": {"choices": ["both"]}}]
        ask("POST", f"/api/tasks/{task['id']}/annotations", json={"result": result})
    exported = ask("GET", f"/api/projects/{project}/export", params={"exportType": "JSON"}).json()
    return {
        "predictions": imported["prediction_count"],
        "pictures": pictures,
        "exported": exported,
    }


def until_up(url: str, session: requests.Session, server: "subprocess.Popen[bytes]") -> None:
    """Wait until the server answers."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s and server.poll() is None:
        with suppress(requests.ConnectionError):
            if session.get(f"{url}/health", timeout=5).ok:
                return
        time.sleep(0.5)
    raise SystemExit("Label Studio does not answer")


main(Path(sys.argv[1]))
