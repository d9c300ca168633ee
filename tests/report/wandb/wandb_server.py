"""A stand-in of a W&B server on this machine: it answers what W&B 0.31 asks for, and remembers what it was sent."""

import contextlib
import gzip
import json
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

API_KEY = "0" * 40


class WandbServer(ThreadingHTTPServer):
    """Runs, files and views that were sent, by id or name.

    Attributes:
        runs: what was said of every run: name, project, job type, tags, config.
        streams: lines of every stream (history, summary, ...) of every run.
        files: uploaded files, by path.
        artifacts: tables that were committed, by id.
        views: saved dashboards.
        unknown: operations that have no answer here.
        refused: HTTP status of operations that are to fail, by the operation's name.
    """

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.runs: dict[str, dict[str, Any]] = {}
        self.streams: dict[str, dict[str, list[Any]]] = {}
        self.files: dict[str, bytes] = {}
        self.artifacts: dict[str, dict[str, Any]] = {}
        self.committed: list[str] = []
        self.views: list[dict[str, Any]] = []
        self.unknown: list[str] = []
        self.refused: dict[str, int] = {}

    @property
    def url(self) -> str:
        """Return its address, for WANDB_BASE_URL."""
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing when a client hangs up."""

    def history(self, run: str) -> list[dict[str, Any]]:
        """Return the rows of a run's charts."""
        return self.streams[run]["wandb-history.jsonl"]

    def summary(self, run: str) -> dict[str, Any]:
        """Return the last summary of a run."""
        return self.streams[run]["wandb-summary.json"][-1]

    def answer(self, query: str, given: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        """Return HTTP status and answer to a GraphQL operation."""
        match = re.search(r"(query|mutation)\s+(\w+)", query)
        assert match is not None
        if status := self.refused.get(match[2]):
            return status, {"errors": [{"message": "refused here"}]}
        method = getattr(self, f"on_{match[2]}", None)
        if method is not None:
            return 200, {"data": method(given.get("input", given))}
        field = re.search(r"{\s*(\w+)", query)
        assert field is not None
        if match[1] == "mutation":
            self.unknown.append(match[2])
        return 200, {"data": {field[1]: None}}

    def on_Viewer(self, given):  # noqa: N802
        names = {"id": "u1", "username": "me", "name": "me", "entity": "me", "email": None}
        return {"viewer": {**names, "flags": "{}", "teams": {"edges": []}, "admin": False}}

    on_GetDefaultEntity = on_Viewer  # noqa: N815

    def on_ServerFeaturesQuery(self, given):  # noqa: N802
        return {"serverInfo": {"features": []}}

    def on_UpsertBucket(self, given):  # noqa: N802
        name = given["name"]
        run = self.runs.setdefault(name, {})
        run |= {key: value for key, value in given.items() if value is not None}
        project = {"id": "p1", "name": run["project"], "entity": {"id": "e1", "name": "me"}}
        shown = {"id": name, "name": name, "displayName": run.get("displayName"), "description": None, "config": "{}"}
        bucket = {**shown, "sweepName": None, "historyLineCount": 0, "project": project}
        return {"upsertBucket": {"bucket": bucket, "inserted": True}}

    def on_CreateRunFiles(self, given):  # noqa: N802
        files = [{"name": name, "uploadUrl": f"{self.url}/upload/{given['run']}/{name}"} for name in given["files"]]
        return {"createRunFiles": {"runID": given["run"], "uploadHeaders": [], "files": files}}

    def on_CreateArtifact(self, given):  # noqa: N802
        name = given["artifactCollectionName"]
        self.artifacts[name] = given
        found = {"id": name, "state": "PENDING", "artifactSequence": {"id": name, "latestArtifact": None}}
        return {"createArtifact": {"artifact": found}}

    def on_CreateArtifactManifest(self, given):  # noqa: N802
        upload = {"uploadUrl": f"{self.url}/upload/{given['artifactID']}/manifest.json", "uploadHeaders": []}
        file = {"id": "f1", **(upload if given["includeUpload"] else {})}
        return {"createArtifactManifest": {"artifactManifest": {"id": given["artifactID"], "file": file}}}

    def on_UpdateArtifactManifest(self, given):  # noqa: N802
        name = given["artifactManifestID"]
        file = {"id": "f1", "uploadUrl": f"{self.url}/upload/{name}/manifest.json", "uploadHeaders": []}
        return {"updateArtifactManifest": {"artifactManifest": {"id": name, "file": file}}}

    def on_CreateArtifactFiles(self, given):  # noqa: N802
        edges = []
        for spec in given["artifactFiles"]:
            place = f"{self.url}/upload/{spec['artifactID']}/{spec['name']}"
            node = {"id": "f1", "name": spec["name"], "displayName": spec["name"], "uploadUrl": place}
            node |= {"uploadHeaders": [], "storagePath": None, "uploadMultipartUrls": None}
            edges.append({"node": {**node, "artifact": {"id": spec["artifactID"]}}})
        return {"createArtifactFiles": {"files": {"edges": edges}}}

    def on_CommitArtifact(self, given):  # noqa: N802
        self.committed.append(given["artifactID"])
        return {"commitArtifact": {"artifact": {"id": given["artifactID"], "digest": "d"}}}

    def on_UpsertView2(self, given):  # noqa: N802
        self.views.append(given)
        return {"upsertView": {"view": {"id": "v1", "name": given["name"]}, "inserted": True}}


class Handler(BaseHTTPRequestHandler):
    """Requests of W&B: GraphQL, streams of rows, uploads; anything else, such as telemetry, gets an empty answer."""

    protocol_version = "HTTP/1.1"
    server: WandbServer

    def log_message(self, format: str, *args: Any) -> None:
        """Write no log."""

    def body(self) -> bytes:
        """Return what was sent."""
        if self.headers.get("Transfer-Encoding") == "chunked":
            parts = []
            while length := int(self.rfile.readline(), 16):
                parts.append(self.rfile.read(length))
                self.rfile.readline()
            self.rfile.readline()
            content = b"".join(parts)
        else:
            content = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        return gzip.decompress(content) if self.headers.get("Content-Encoding") == "gzip" else content

    def do_POST(self) -> None:
        """Answer a request."""
        content, status, answer = self.body(), 200, {}
        if self.path == "/graphql":
            asked = json.loads(content)
            status, answer = self.server.answer(asked["query"], asked.get("variables") or {})
        elif self.path.endswith("/file_stream"):
            streams = self.server.streams.setdefault(self.path.split("/")[-2], {})
            for name, part in (json.loads(content).get("files") or {}).items():
                lines = part["content"]
                read = [json.loads(line) for line in lines] if name.endswith((".jsonl", ".json")) else lines
                streams.setdefault(name, []).extend(read)
        elif self.path.startswith("/upload/"):
            self.server.files[self.path.removeprefix("/upload/")] = content
        encoded = json.dumps(answer).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(encoded)))
        self.end_headers()
        self.wfile.write(encoded)

    do_GET = do_PUT = do_POST  # noqa: N815


@contextlib.contextmanager
def wandb_server() -> Iterator[WandbServer]:
    """Run a server in a thread."""
    server = WandbServer()
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
