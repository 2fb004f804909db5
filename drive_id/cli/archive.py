"""``drive-id index`` and ``drive-id serve``: all results below a folder in a browser."""

from pathlib import Path
from typing import Annotated

import typer

from drive_id.cli import console, options
from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError


def index_results(
    folders: Annotated[
        list[Path], typer.Argument(help="Folder below which the results are, or results to compare.", metavar="DIR...")
    ],
    output: Annotated[Path | None, options.output("Page.  \\[default: DIR/index.html]")] = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Write one page of all results below a folder: sorted, filtered, compared, and over time for each machine."""
    from drive_id.files.results.folder import is_result
    from drive_id.reporting.web.archive import Archive, entries_of
    from drive_id.reporting.web.page import archive_page, check_page_output, write_page

    compared = len(folders) > 1 or is_result(folders[0])
    if compared and output is None:
        raise ConfigurationError("Results that are compared have no folder of their own: say with --output which page.")
    path = output or folders[0] / "index.html"
    archive = None if compared else Archive(folders[0])
    check_page_output(path)
    found = entries_of(folders, path.parent) if archive is None else archive.entries(path.parent)
    names = ", ".join(folder.resolve().name for folder in folders[:3]) + (" …" if len(folders) > 3 else "")
    title = f"Results compared: {names}" if compared else f"Results in {'/'.join(folders[0].resolve().parts[-2:])}"
    write_page(path, archive_page(found, title, ticked=len(found) if compared else 0))
    if as_json:
        console.print_json({"page": str(path), "results": [str(entry.folder) for entry in found]})
    elif not quiet:
        console.say(f"{path}: {counted(len(found), 'result')}.")


def serve_results(
    folder: Annotated[Path, typer.Argument(help="Folder below which the results are.", show_default=False)],
    host: Annotated[str, typer.Option(help="Address to listen on; any but localhost needs a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port.", min=0, max=65535)] = 8080,
    token: Annotated[
        str, typer.Option(help="Token that clients must send.  \\[default: a new one if not 127.0.0.1]")
    ] = "",
    namespace: Annotated[str, typer.Option(help="ROS namespace of the drive on the live page.")] = "",
    archive_only: Annotated[bool, typer.Option("--archive-only", help="Do not listen to ROS.")] = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Serve all results below a folder, and with ROS 2 a live page of an experiment, read-only."""
    try:
        import uvicorn

        from drive_id.reporting.web.server import LOOPBACK, application, ros_found
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"drive-id serve needs {error.name}: pip install 'drive_id[web]'; drive-id index needs nothing."
        ) from error
    import contextlib
    import secrets

    token = token or ("" if host in LOOPBACK else secrets.token_urlsafe(16))
    live = not archive_only and ros_found()
    app = application(folder, namespace=namespace, token=token, live=live)
    address, query = f"http://{host}:{port}", f"?token={token}" if token else ""
    if as_json:
        console.print_json({"archive": f"{address}/{query}", "live": f"{address}/live{query}" if live else None})
    elif not quiet:
        console.say(f"{address}/{query}: the results in {folder}.")
        if live:
            console.say(f"{address}/live{query}: an experiment as it runs.")
        elif not archive_only:
            console.say("No live page: ROS 2 or drive_id_msgs is not installed in this environment.")
    server = uvicorn.Server(uvicorn.Config(app, host, port, log_level="warning", timeout_graceful_shutdown=1))
    with contextlib.suppress(KeyboardInterrupt):  # how a server ends
        server.run()
    if not server.started:
        raise ConfigurationError(f"The port {port} at {host} cannot be opened: give another --port or --host.")
