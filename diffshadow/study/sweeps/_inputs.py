"""What workers that share no files are given: copies of inputs, each sent once to a worker that needs it.

A copy is the result of a Dask task, whose key is a hash of the content. So Dask sends it to a worker once, passes it on
between workers, and makes it again if a worker is lost.
"""

import hashlib
import json
import shutil
import tempfile
import warnings
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ... import io
from ...config import Config, input_files, user_modules
from ...reference import KeyedScene
from ..runs._progress import Progress
from ..runs._setup import keyed_scenes, keys_of_references
from ._work import Batch, reference_of

# The most bytes of copies that the cluster keeps for batches to come.
_MAX_KEPT = 1 << 30


class Inputs(NamedTuple):
    """What `work_apart` is given with a batch, as futures where it is a copy."""

    pickled: bytes
    contents: Mapping[str, Any]
    references: Mapping[str, Any]
    missing: list[str]


class Sender:
    """Sends the inputs of batches to the workers of a Dask `client`."""

    def __init__(self, client: Any):
        self._client = client
        self._copies: OrderedDict[str, tuple[Any, int]] = OrderedDict()
        self._hashes: dict[tuple[str, int, int], str] = {}
        self._keys: dict[str, list[str]] = {}
        self._references: dict[str, str] = {}
        self._scene: tuple[str, list[KeyedScene]] | None = None
        self._modules: set[Path] = set()

    def of(self, batch: Batch) -> Inputs:
        """The inputs of `batch`."""
        from distributed.protocol.pickle import dumps

        configs = [config for run in batch.runs for config in (run.config, *run.frames)]
        for module in {module for config in configs for module in user_modules(config)} - self._modules:
            self._upload(module)
        hashes, contents = {}, {}
        for file in dict.fromkeys(file for config in configs for file in input_files(config)):
            # The worker reports a file that cannot be read.
            if file.is_file():
                hashes[str(file)], copy = self._copy_of(file)
                contents[hashes[str(file)]] = copy
        references, missing = {}, []
        for key in self._keys_of(configs) if batch.shares else ():
            copy = self._reference_of(key)
            if copy is None:
                missing.append(key)
            else:
                references[key] = copy
        return Inputs(dumps((batch, hashes)), contents, references, missing)

    def _copy_of(self, file: Path) -> tuple[str, Any]:
        """The hash of a file's content, and its copy."""
        status = file.stat()
        version = str(file), status.st_mtime_ns, status.st_size
        if (known := self._hashes.get(version)) in self._copies:
            self._copies.move_to_end(known)
            return known, self._copies[known][0]
        content = file.read_bytes()
        found = self._hashes[version] = hashlib.sha256(content).hexdigest()
        return found, self._sent(found, content)

    def _reference_of(self, key: str) -> Any | None:
        """The copy of a cached reference; none if it is not cached here."""
        if (known := self._references.get(key)) in self._copies:
            return self._copies[known][0]
        content = io.cached_content(key)
        if content is None:
            return None
        found = self._references[key] = hashlib.sha256(content).hexdigest()
        return self._sent(found, content)

    def _sent(self, hash: str, content: bytes) -> Any:
        if hash not in self._copies:
            with warnings.catch_warnings():
                # Of large tasks. A copy must be a task, so that it can be made again.
                warnings.simplefilter("ignore", UserWarning)
                future = self._client.submit(bytes, content, key=f"diffshadow-input-{hash}")
            self._copies[hash] = future, len(content)
            while len(self._copies) > 1 and sum(size for _, size in self._copies.values()) > _MAX_KEPT:
                self._copies.popitem(last=False)
        self._copies.move_to_end(hash)
        return self._copies[hash][0]

    def _keys_of(self, configs: Iterable[Config]) -> list[str]:
        """The keys of all references that are traced for `configs`."""
        found: list[str] = []
        for config in configs:
            for each in (config, *(view.config for view in (*config.views, *config.validation))):
                text = reference_of(each)
                if text not in self._keys:
                    self._keys[text] = keys_of_references(each, self._keyed_scenes(each))
                found += self._keys[text]
        return list(dict.fromkeys(found))

    def _keyed_scenes(self, config: Config) -> list[KeyedScene]:
        """The scenes of `config`, built again only if it has another scene than the last."""
        text = json.dumps(config.model_dump(mode="json", warnings=False, include={"scene"}))
        if self._scene is None or self._scene[0] != text:
            self._scene = text, keyed_scenes(config, Progress.quiet())
        return self._scene[1]

    def _upload(self, module: Path) -> None:
        """Gives a user's module or package to all workers, also to those to come.

        **Raises** `ValueError` if a worker cannot load it.
        """
        from distributed.diagnostics.plugin import UploadFile

        self._modules.add(module)
        with tempfile.TemporaryDirectory() as scratch:
            archive = f"{scratch}/{module.name}", "zip", module.parent, module.name
            file = module if module.is_file() else shutil.make_archive(*archive)
            # `Client.upload_file` would also load it in the scheduler, which need not have this package.
            plugin = UploadFile(str(file))
        try:
            self._client.register_plugin(plugin, name=f"diffshadow-{plugin.filename}")
        except Exception as error:
            raise ValueError(
                f"a Dask worker cannot load {module}: {error}; expected a module that needs only what workers have "
                "installed: make it a package with all that it imports, or install it on each worker"
            ) from error
