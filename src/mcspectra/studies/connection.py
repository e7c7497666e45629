"""Connections to dask: schedulers that run already, or a cluster of processes on this machine.

The only module that imports dask, and only when a cluster is asked for.
"""

from __future__ import annotations

import logging
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from mcspectra.core.checks import as_integer, as_real
from mcspectra.core.errors import McspectraError, MissingDependency, ParameterError
from mcspectra.core.parallel import available_workers
from mcspectra.studies import interrupts

if TYPE_CHECKING:
    from distributed import LocalCluster, Security

__all__ = [
    "ClusterError",
    "ClusterLost",
    "ClusterOptions",
    "Connection",
    "connect",
    "killed_worker",
]

_LOOPBACK = "127.0.0.1"
_ADDRESS = re.compile(
    r"(?:(tcp|tls)://)?[\w.-]+:\d{1,5}|(?:(tcp|tls)://)?\[[0-9a-fA-F:]+\]:\d{1,5}"
)
_FRESH = 2.0  # seconds for which the number of workers is believed
_CLOSING = 5.0  # seconds to say goodbye


class ClusterError(McspectraError, RuntimeError):
    """A cluster cannot be reached, or its workers cannot run the study."""


class ClusterLost(ClusterError):
    """The scheduler went away while a study ran; what was finished is stored."""


@final
@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Where the workers are.

    Attributes
    ----------
    address
        ``local`` starts worker processes on this machine; ``tcp://HOST:PORT`` or ``tls://HOST:PORT``
        is a scheduler that runs already, a path that ends in .json the file that it wrote.
    workers
        Worker processes of one thread each, for ``local``; all processors by default.
    host
        Where the scheduler of ``local`` listens: this machine alone can reach the default.
    dashboard
        Port of dask's dashboard, for ``local``; 0 takes a free one.
    tls_ca, tls_cert, tls_key
        Certificate authority, certificate and key (.pem files), all three or none. With them nothing
        is sent or accepted without TLS.
    time_limit
        Seconds after which a task has failed and its worker is restarted.
    patience
        Seconds to wait for the scheduler, at the start and when the connection is lost.

    Raises
    ------
    ParameterError
        A value is out of range, or two do not go together.
    """

    address: str = "local"
    workers: int | None = None
    host: str = _LOOPBACK
    dashboard: int = 0
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    time_limit: float | None = None
    patience: float = 30.0

    def __post_init__(self) -> None:
        as_integer("dashboard", self.dashboard, least=0, most=65535)
        as_real("patience", self.patience, above=0.0)
        if self.time_limit is not None:
            as_real("time_limit", self.time_limit, above=0.0)
        available_workers(self.workers)
        self._check_address()
        self._check_tls()

    @property
    def local(self) -> bool:
        """Whether the cluster is started for this study, on this machine."""
        return self.address == "local"

    @property
    def tls(self) -> bool:
        """Whether connections are encrypted and both ends named by certificates."""
        return self.tls_ca is not None

    @property
    def scheduler_file(self) -> Path | None:
        """The file in which a scheduler wrote its address."""
        return Path(self.address) if str(self.address).endswith(".json") else None

    def _check_address(self) -> None:
        if self.local:
            return
        if self.workers is not None or self.host != _LOOPBACK or self.dashboard:
            raise ParameterError(
                f"The cluster at {self.address} has its own workers, host and dashboard; give those "
                "options with the cluster 'local' only."
            )
        if self.scheduler_file is None and not _ADDRESS.fullmatch(str(self.address)):
            raise ParameterError(
                f"The cluster's address is {self.address!r}; give tcp://HOST:PORT, tls://HOST:PORT, "
                "the .json file that the scheduler wrote, or 'local'."
            )

    def _check_tls(self) -> None:
        files = (self.tls_ca, self.tls_cert, self.tls_key)
        if None in files and files != (None, None, None):
            raise ParameterError(
                "TLS takes three files; give the certificate authority, the certificate and the key."
            )
        for file in files:
            if file is not None and not Path(file).is_file():
                raise ParameterError(f"There is no file {str(file)!r}, which TLS is to use.")
        if self.tls and self.address.startswith("tcp://"):
            raise ParameterError(
                f"The address {self.address} is without TLS; write tls:// instead."
            )
        if not self.tls and self.address.startswith("tls://"):
            raise ParameterError(
                f"The address {self.address} needs TLS; give the certificate authority, the "
                "certificate and the key."
            )


@final
class Connection:
    """A client of a dask scheduler."""

    def __init__(
        self, client: Any, cluster: LocalCluster | None, unmute: Callable[[], None]
    ) -> None:
        self._client = client
        self._cluster = cluster
        self._unmute = unmute
        self._threads = (0, -_FRESH)
        self.address = str(client.scheduler.address)
        self.dashboard = str(client.dashboard_link or "")

    @property
    def alive(self) -> bool:
        """Whether the scheduler answers, or may answer again."""
        return self._client.status in ("running", "connecting", "newly-created")

    @property
    def ready(self) -> bool:
        """Whether the scheduler is there."""
        return bool(self._client.status == "running")

    def threads(self) -> int:
        """Worker threads, as of two seconds ago at most."""
        now = time.monotonic()
        if now - self._threads[1] >= _FRESH and self.ready:
            with suppress(OSError):
                self._threads = (sum(self._client.nthreads().values()), now)
        return self._threads[0]

    def submit(self, key: tuple[str, ...], function: Callable[..., Any], *arguments: Any) -> Any:
        """Have a function called on some worker, again on another if that one dies."""
        return self._client.submit(function, *arguments, key=key, pure=False, retries=0)

    def versions(self) -> dict[str, str]:
        """The version of this package on each worker, in words where there is none."""
        found = self._client.run(metadata.version, "mcspectra", on_error="return")
        return {
            address: "no version" if isinstance(version, Exception) else str(version)
            for address, version in found.items()
        }

    def hosts(self, workers: list[str]) -> dict[str, str]:
        """Names of the machines of some workers."""
        return dict(self._client.run(socket.gethostname, workers=workers))

    def restart_worker(self, future: Any) -> None:
        """Restart the workers that hold a future's result, as a task that was given up runs there."""
        workers = [each for holders in self._client.who_has([future]).values() for each in holders]

        def restart() -> None:
            with suppress(Exception):  # a worker without a nanny, or gone
                self._client.restart_workers(workers, timeout=60, raise_for_error=False)

        threading.Thread(target=restart, daemon=True).start()

    def cancel(self, futures: list[Any]) -> None:
        """Stop waiting for tasks; those that run are not stopped."""
        with suppress(Exception):
            self._client.cancel(futures, force=True)

    def close(self) -> None:
        """Close the client, and the cluster if it was started here."""
        with suppress(Exception):
            self._client.close(timeout=_CLOSING)
        if self._cluster is not None:
            self._cluster.close(timeout=_CLOSING)
        self._unmute()


def connect(options: ClusterOptions) -> Connection:
    """Start a cluster here, or connect to one that runs.

    Raises
    ------
    MissingDependency
        The package distributed is not installed.
    ClusterError
        Nobody answers, or a port is taken.
    """
    distributed = _load_distributed()
    unmute = _mute()
    cluster = None
    try:
        security = _security(options)
        cluster = _local_cluster(options, security) if options.local else None
        client = distributed.Client(
            _target(options, cluster),
            security=security,
            timeout=options.patience,
            set_as_default=False,
        )
    except (OSError, RuntimeError, ValueError) as error:
        if cluster is not None:
            cluster.close(timeout=_CLOSING)
        unmute()
        raise _unreachable(options, error) from error
    return Connection(client, cluster, unmute)


def killed_worker() -> type[Exception]:
    """The error of a task whose workers died: attribute `allowed_failures`, one less than they are."""
    from distributed import KilledWorker

    return KilledWorker


def _load_distributed() -> Any:
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise MissingDependency(
            f"Clusters need the package {error.name}; install it with: "
            "pip install 'mcspectra[cluster]'"
        ) from error
    return distributed


def _mute() -> Callable[[], None]:
    """Keep dask's log off the terminal: what matters is said in sentences. Returns the inverse."""
    handlers = [(each, each.level) for each in logging.getLogger("distributed").handlers]
    for handler, _ in handlers:
        handler.setLevel(logging.CRITICAL + 1)

    def unmute() -> None:
        for handler, level in handlers:
            handler.setLevel(level)

    return unmute


def _security(options: ClusterOptions) -> Security | None:
    if not options.tls:
        return None
    import distributed

    cert, key = str(options.tls_cert), str(options.tls_key)
    make: Any = distributed.Security
    security: Security = make(
        require_encryption=True,
        tls_ca_file=str(options.tls_ca),
        **{f"tls_{role}_cert": cert for role in ("client", "scheduler", "worker")},
        **{f"tls_{role}_key": key for role in ("client", "scheduler", "worker")},
    )
    return security


def _local_cluster(options: ClusterOptions, security: Security | None) -> LocalCluster:
    """Processes of one thread each, which are replaced when they die."""
    import distributed

    make: Any = distributed.LocalCluster
    with interrupts.blocked():  # the cluster's thread too, which starts workers that replace others
        cluster: LocalCluster = make(
            n_workers=available_workers(options.workers),
            threads_per_worker=1,
            processes=True,
            host=options.host,
            protocol="tls://" if options.tls else "tcp://",
            dashboard_address=f"{options.host}:{options.dashboard}",
            security=security,
            silence_logs=logging.CRITICAL,
        )
    return cluster


def _target(options: ClusterOptions, cluster: LocalCluster | None) -> Any:
    """What dask's client takes as an address."""
    if cluster is not None:
        return cluster
    if options.scheduler_file is not None:
        return _address_in(options.scheduler_file)
    plain = "://" not in options.address
    return f"{'tls' if options.tls else 'tcp'}://{options.address}" if plain else options.address


def _address_in(file: Path) -> str:
    import msgspec

    class Found(msgspec.Struct):
        address: str

    try:
        return msgspec.json.decode(file.read_bytes(), type=Found).address
    except (OSError, msgspec.DecodeError) as error:
        raise ParameterError(
            f"{str(file)!r} is not a file that a dask scheduler wrote (--scheduler-file): {error}."
        ) from error


def _unreachable(options: ClusterOptions, error: Exception) -> McspectraError:
    if isinstance(error, McspectraError):
        return error
    reason = " ".join(str(error).split()).rstrip(".")
    if options.local:
        return ClusterError(f"No cluster can be started on {options.host}: {reason}.")
    return ClusterError(
        f"No dask scheduler answers at {options.address} within {options.patience:g} s ({reason}); "
        "check the address, the TLS files and that it runs."
    )
