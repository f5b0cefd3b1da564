"""An SSH server on loopback that serves a folder by SFTP: what `dvc remote add lab ssh://…` talks to."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from threading import Event, Thread

import asyncssh


@contextmanager
def serving(folder: Path, home: Path) -> Iterator[int]:
    """Serve `folder` as ``/`` to whoever has the key that is put where SSH looks for it in `home`; yield the port."""
    key = asyncssh.generate_private_key("ssh-ed25519")
    (home / ".ssh").mkdir(mode=0o700)
    key.write_private_key(home / ".ssh/id_ed25519")
    ports: Queue[int] = Queue()
    end = Event()
    thread = Thread(target=lambda: asyncio.run(_serve(folder, key, ports, end)), daemon=True)
    thread.start()
    try:
        yield ports.get(timeout=60)
    finally:
        end.set()
        thread.join(timeout=10)


async def _serve(folder: Path, key: asyncssh.SSHKey, ports: Queue[int], end: Event) -> None:
    async with asyncssh.listen(
        "127.0.0.1", 0, server_host_keys=[key],
        authorized_client_keys=asyncssh.import_authorized_keys(key.export_public_key().decode()),
        sftp_factory=lambda channel: asyncssh.SFTPServer(channel, chroot=str(folder).encode()),
    ) as server:  # fmt: skip
        ports.put(server.get_port())
        await asyncio.to_thread(end.wait)
