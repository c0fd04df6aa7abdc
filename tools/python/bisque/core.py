"""The steps of the C libraries as functions: sort, voxelize, simplify, bake, compare."""
from __future__ import annotations

import contextlib
import difflib
import itertools
import os
import re
import shutil
import tempfile
import threading
import warnings
import weakref
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Sequence

import numpy as np

from .images import srgb, write_png
from .lib._core import ffi, lib
from .mesh import (Error, Mesh, as_mesh, check_number, check_real, check_triangles, is_path, parse_amount,
                   parse_bytes, parse_texels, read_mesh)

#: Gets (stage, done, total, unit); total is 0 if it is unknown. An exception ends the job.
Progress = Callable[[str, int, int, str], Any]
#: Gets the warnings of all jobs of a context (`warn(line)`), which else become Python's, and the files
#: that they read (`read(path, identity)`; the identity, as bsq_identity_text() writes it, is "" for
#: files that another program opened, and for those that were missing).
listener: ContextVar[Any] = ContextVar("listener", default=None)
_silent: ContextVar[bool] = ContextVar("silent", default=False)
#: When it is set, the jobs and programs of threads in this context end.
stopping: ContextVar[threading.Event | None] = ContextVar("stopping", default=None)


def check_stopping() -> None:
    """Raises KeyboardInterrupt in a thread that shall end."""
    event = stopping.get()
    if event and event.is_set():
        raise KeyboardInterrupt


@contextlib.contextmanager
def quiet() -> Any:
    """Drops warnings of jobs that the caller has had before."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


def version() -> str:
    """Returns the version of the library."""
    return ffi.string(lib.bsq_version()).decode()


def _text(value: Any) -> str:
    return ffi.string(value).decode(errors="surrogateescape") if value else ""


@ffi.def_extern()
def on_progress(user: Any, progress: Any) -> None:
    job = ffi.from_handle(user)
    if job.progress and not job.failure:
        try:
            job.progress(_text(progress.stage), progress.done, progress.total,
                         _text(progress.unit))
        except BaseException as failure:  # of the caller: the job ends with it
            job.failure = failure
            lib.bsq_interrupt(job.ctx)


@ffi.def_extern()
def on_warning(user: Any, line: Any) -> None:
    ffi.from_handle(user).warnings.append(_text(line))


@ffi.def_extern()
def on_rows(user: Any, rows: Any) -> int:
    job = ffi.from_handle(user)
    try:
        job.take_rows(rows)
        return 0
    except BaseException as failure:
        job.failure = failure
        return -71 if isinstance(failure, MemoryError) else -70


@ffi.def_extern()
def on_read(user: Any, to: Any, count: int, offset: int) -> int:
    source = ffi.from_handle(user)
    try:
        source.give(ffi.cast("char *", to), count, offset)
        return 0
    except BaseException as failure:
        source.job.failure = failure
        return -71 if isinstance(failure, MemoryError) else -70


def _remove(folder: str) -> None:
    """Removes a temporary folder with all that is in it, also if a signal comes meanwhile."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except BaseException:  # a signal
        shutil.rmtree(folder, ignore_errors=True)
        raise


class Job:
    """A context of the library. Calls run in a thread without the GIL, while this one waits and can
    be interrupted."""

    def __init__(self, memory: int | str | None = None, threads: int = 0,
                 tmpdir: str | os.PathLike | None = None, progress: Progress | None = None):
        self.kept: list[Any] = []
        self.progress, self.failure = progress, None
        self.warnings: list[str] = []
        self.maps: dict[tuple[str, str], np.ndarray] = {}
        self.handle = ffi.new_handle(self)
        self.folder: str | None = None
        self.tmpdir = os.fspath(tmpdir) if tmpdir else None
        options = ffi.new("struct bsq_ctx_options *", {
            "size": ffi.sizeof("struct bsq_ctx_options"), "memory_bytes": parse_bytes(memory),
            "threads": check_number("threads", threads, 0, 2 ** 32 - 1),
            "on_progress": lib.on_progress, "on_warning": lib.on_warning, "user": self.handle,
            "tmpdir": self.string(self.tmpdir)})
        out = ffi.new("struct bsq_ctx **")
        self.ctx = ffi.NULL
        if lib.bsq_ctx_create(options, out) < 0:
            raise MemoryError("no memory for a context")
        self.ctx = out[0]

    def __enter__(self) -> "Job":
        return self

    def __exit__(self, *_: Any) -> None:
        lib.bsq_ctx_destroy(self.ctx)
        if self.folder:
            _remove(self.folder)
        for line in [] if _silent.get() else self.warnings:
            if listener.get():
                listener.get().warn(line)
            else:
                warnings.warn(line, stacklevel=4)

    def keep(self, thing: Any) -> Any:
        self.kept.append(thing)
        return thing

    def string(self, text: Any) -> Any:
        """Returns a C string that lives as long as the job, or NULL. Raises ValueError."""
        data = os.fsencode(text or "")
        if b"\0" in data:
            raise ValueError(f"{text!r}: a name has no zero bytes")
        return ffi.NULL if text is None else self.keep(ffi.new("char[]", data))

    def strings(self, texts: Sequence[Any]) -> Any:
        return self.keep(ffi.new("const char *[]", [self.string(text) for text in texts]))

    def temporary(self, name: str) -> str:
        """Returns a path in a folder that goes with the job."""
        if self.folder is None:
            self.folder = tempfile.mkdtemp(prefix="bisque-", dir=self.tmpdir)
        return os.path.join(self.folder, name)

    def run(self, function: Callable, *arguments: Any) -> None:
        """Calls a function that takes the context and returns a status. Raises Error, the exception
        of a callback, or KeyboardInterrupt, after the library has stopped."""
        status: list[int] = []
        ended = threading.Event()  # an interrupted Thread.join() may take a thread for ended

        def call() -> None:
            try:
                status.append(function(self.ctx, *arguments))
            finally:
                ended.set()

        lib.bsq_forget_files(self.ctx)
        thread = threading.Thread(target=call)
        interrupted, begun = None, False
        while True:
            try:
                if not begun:
                    begun = True
                    thread.start()
                while not ended.wait(0.2):  # a signal need not end a wait without an end
                    check_stopping()
                break
            except BaseException as interruption:
                interrupted = interruption
                lib.bsq_interrupt(self.ctx)
                # Interrupted within start(), the thread may never begin.
                if thread.ident is None and not ended.wait(1) and thread.ident is None:
                    raise
        if self.failure or interrupted:
            raise self.failure or interrupted
        if not status:
            raise Error(70, "the call into the library failed")
        if status[0] < 0:
            message = _text(lib.bsq_error(self.ctx))
            raise Error(-status[0], message.replace(f"{self.folder}{os.sep}", "") if self.folder else message)
        if listener.get():
            self.tell_files()

    def tell_files(self) -> None:
        """Tells the listener which files the last call read, but for temporary ones of this job."""
        following, item = ffi.new("uint64_t *"), ffi.new("struct bsq_noted_input *")
        identity = ffi.new("char[]", lib.BSQ_IDENTITY_BYTES)
        while (found := lib.bsq_next_input(self.ctx, following, item)) > 0:
            path = os.fsdecode(ffi.string(item.path))
            lib.bsq_identity_text(ffi.addressof(item, "found"), identity)
            if not item.own and not (self.folder and path.startswith(self.folder)):
                listener.get().read(path, ffi.string(identity).decode() if item.opened else "")
            lib.bsq_noted_input_free(item)
        if found < 0:
            raise MemoryError("no memory for the list of files")

    def take_rows(self, rows: Any) -> None:
        key = (_text(rows.map), _text(rows.path))
        if key not in self.maps:
            self.maps[key] = np.empty((rows.height, rows.width, rows.channels), np.float32)
        part = self.maps[key][rows.first:rows.first + rows.count]
        ffi.memmove(ffi.from_buffer(part), rows.samples, part.nbytes)


def _new_report(name: str) -> Any:
    report = ffi.new(name + " *")
    report.size = ffi.sizeof(name)
    return report


def _plain(value: Any) -> Any:
    """Turns a C structure into a dict, and other values into those of Python."""
    if not isinstance(value, ffi.CData):
        return value
    kind = ffi.typeof(value)
    if kind.kind == "pointer" and kind.item.kind == "struct":
        return _plain(value[0])
    if kind.kind == "struct":
        return {name: _plain(getattr(value, name)) for name, _ in kind.fields if name != "size"}
    if kind.kind == "pointer" or (kind.kind == "array" and kind.item.cname == "char"):
        return _text(value)
    return [_plain(item) for item in value]


def _is_memory(scan: Any) -> bool:
    """Returns whether a scan is a mesh in memory, and not a path or a list of paths."""
    return not (is_path(scan) or
                (isinstance(scan, (list, tuple)) and all(is_path(item) for item in scan)))


def _paths(scan: Any) -> list[str]:
    if not is_path(scan) and not scan:
        raise ValueError("scan: a list without a path")
    return [os.fsdecode(scan)] if is_path(scan) else [os.fsdecode(item) for item in scan]


def refuse_tokens(folder: str | os.PathLike) -> None:
    """Refuses the name of a folder of maps of which the library would replace a part, by ValueError."""
    if token := re.search("<(MAP|UDIM|UVTILE|OBJECT|MATERIAL)>", os.path.abspath(folder)):
        raise ValueError(f"{folder}: {token[0]} in the name of a folder would be replaced")


class _Source:
    """The bytes of a file of elements in memory. They are made when the library reads them, so there is no copy of
    the arrays. elements: of each kind its type, its number, and the values of its members: an array or a number."""

    def __init__(self, job: Job, elements: Sequence[tuple[np.dtype, int, dict]]):
        self.job, self.elements = job, elements
        self.bytes = sum(number * kind.itemsize for kind, number, _ in elements)

    def give(self, to: Any, count: int, offset: int) -> None:
        """Copies `count` bytes from byte `offset` on to `to`."""
        for kind, number, members in self.elements:
            size = number * kind.itemsize
            begin, end = (min(max(at, 0), size) for at in (offset, offset + count))
            offset -= size
            if begin == end:
                continue
            first, last = begin // kind.itemsize, -(-end // kind.itemsize)
            rows = np.empty(last - first, kind)
            for name, values in members.items():
                rows[name] = values[first:last] if isinstance(values, np.ndarray) else values
            part = rows.view(np.uint8)[begin - first * kind.itemsize:][:end - begin]
            ffi.memmove(to, ffi.from_buffer(part), end - begin)
            to += end - begin


def _joined(mesh: Mesh) -> Mesh:
    """Returns a mesh whose normals are those of its vertices. One with several normals is there as many times."""
    if mesh.normals is None or mesh.normal_faces is None or mesh.normal_faces is mesh.faces:
        return mesh
    pairs = mesh.faces.astype(np.int64) * len(mesh.normals) + mesh.normal_faces.astype(np.int64)
    pairs, faces = np.unique(pairs, return_inverse=True)
    vertices, normals = np.divmod(pairs, len(mesh.normals))
    colors = None if mesh.colors is None else mesh.colors[vertices]
    return replace(mesh, vertices=mesh.vertices[vertices], faces=faces.reshape(-1, 3), colors=colors,
                   normals=mesh.normals[normals], normal_faces=None)


def _source(job: Job, scan: Any) -> Any:
    """Makes a scan in memory an input of the library: a PLY file whose bytes are made on demand."""
    mesh = _joined(as_mesh(scan))
    colors, normals = None if mesh.colors is None else mesh.colors[:, :3], mesh.normals
    kind = getattr(getattr(scan, "visual", None), "kind", None)
    if kind == "face":
        job.warnings.append("mesh in memory: colours of faces are not read: write it to a file, such as "
                            "mesh.export('scan.ply'), and give its path")
    if mesh.texture is None and (kind == "texture" or len(getattr(scan, "textures", ()))):
        job.warnings.append("mesh in memory: its material and texture are not read: write it to a file, "
                            "such as mesh.export('scan.obj'), and give its path")
    wide = mesh.vertices.dtype != np.float32
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property {'double' if wide else 'float'} {k}" for k in "xyz"]
    lines += [f"property float n{k}" for k in "xyz" if normals is not None]
    lines += [f"property uchar {k}" for k in ("red", "green", "blue") if colors is not None]
    lines += [f"element face {len(mesh.faces)}", "property list uchar uint vertex_indices",
              "end_header", ""]
    header = np.frombuffer("\n".join(lines).encode(), np.uint8)
    rows = {"position": mesh.vertices, "normal": normals, "color": colors}
    rows = {name: values for name, values in rows.items() if values is not None}
    kinds = {"position": "<f8" if wide else "<f4", "normal": "<f4", "color": "u1"}
    source = job.keep(_Source(job, [
        (np.dtype([("byte", "u1")]), len(header), {"byte": header}),
        (np.dtype([(name, kinds[name], 3) for name in rows]), len(mesh.vertices), rows),
        (np.dtype([("corners", "u1"), ("indices", "<u4", 3)]), len(mesh.faces),
         {"corners": 3, "indices": mesh.faces})]))
    return job.keep(ffi.new("struct bsq_source *", {
        "size": ffi.sizeof("struct bsq_source"), "bytes": source.bytes, "read": lib.on_read,
        "user": job.keep(ffi.new_handle(source))}))


def _written(job: Job, mesh: Mesh) -> tuple[str, str]:
    """Writes a mesh with a texture, and its image, to temporary files. Returns their paths."""
    path, image = job.temporary("mesh.obj"), job.temporary("mesh.png")
    mesh.save(path)
    mesh.texture.save(image)
    return path, image


def _word(name: str, word: str, words: Sequence[str]) -> int:
    if word not in words:
        raise ValueError(f"{name}: {word!r} is none of: {' '.join(words)}")
    return words.index(word)


NORMALS = ("auto", "area", "angle", "max", "flat")


def _kind(job: Job, path: str) -> int:
    kind = ffi.new("enum fmt_kind *")
    job.run(lib.fmt_recognise, job.string(path), kind)
    return int(kind[0])


def _check_meshes(job: Job, paths: list[str]) -> None:
    """Refuses grids and chunk files, which are no meshes. Raises Error."""
    advice = {lib.FMT_KIND_NVDB: "a grid has no triangles; give the scan or its chunk file (.tris)",
              lib.FMT_KIND_TRIS: "a chunk file is no mesh; bisque-voxelize a.tris b.obj -o all.tris joins both"}
    for path in filter(os.path.isfile, paths):
        if (kind := _kind(job, path)) in advice:
            raise Error(65, f"{path}: {advice[kind]}")


def _sort(job: Job, scan: Any, output: str, texture: Any = None, ids: str = "none",
          channels: Sequence[str] | str = (), embed_textures: bool = False,
          scan_normals: str = "auto", temporary: Any = ffi.NULL) -> dict:
    options = ffi.new("struct vox_sort_options *")
    lib.vox_sort_defaults(options)
    mesh = as_mesh(scan) if _is_memory(scan) else None
    if mesh and mesh.texture is not None and temporary == ffi.NULL:
        scan, image = _written(job, mesh)
        texture, embed_textures = texture or image, True
    if _is_memory(scan):
        options.scan_paths, options.scan_count = job.strings(["mesh in memory"]), 1
        options.sources = job.keep(ffi.new("const struct bsq_source *[]", [_source(job, scan)]))
    else:
        paths = _paths(scan)
        _check_meshes(job, paths)
        options.scan_paths, options.scan_count = job.strings(paths), len(paths)
    options.tris_path = job.string(output)
    options.texture_path = job.string(texture)
    options.ids = _word("ids", ids, ("none", "material", "object", "color"))
    names, every = channels.split(",") if isinstance(channels, str) else channels, channels == "all"
    if every:
        names = [_text(lib.fmt_channel_at(i).name) for i in itertools.takewhile(lib.fmt_channel_at, itertools.count())]
    options.channels = job.keep(ffi.new("struct vox_channel[]", [
        {"name": job.string(name), "texture_path": ffi.NULL, "optional": every} for name in names]))
    options.channel_count = len(names)
    options.embed_textures = embed_textures
    options.scan_normals = _word("scan_normals", scan_normals, NORMALS)
    options.temp_tris = temporary
    report = _new_report("struct vox_sort_report")
    job.run(lib.vox_sort, options, report)
    return _plain(report)


def is_chunks(scan: Any, job: Job | None = None) -> bool:
    """Returns whether a scan is of chunk files."""
    if _is_memory(scan):
        return False
    with contextlib.nullcontext(job) if job else Job() as job:
        return all(_kind(job, path) == lib.FMT_KIND_TRIS for path in _paths(scan))


def _chunks(job: Job, scan: Any, scan_normals: str = "flat") -> str:
    """Returns the path of a scan as a chunk file; sorts meshes into a temporary one, or joins chunk
    files, with these vertex normals."""
    chunks = _paths(scan) if is_chunks(scan, job) else []
    if len(chunks) == 1:
        return chunks[0]
    path = job.temporary("scan.tris")
    if chunks:
        options = ffi.new("struct vox_join_options *", {"size": ffi.sizeof("struct vox_join_options")})
        options.tris_paths, options.tris_count = job.strings(chunks), len(chunks)
        options.output_path = job.string(path)
        options.scan_normals = _word("scan_normals", scan_normals, NORMALS)
        job.run(lib.vox_join, options, _new_report("struct vox_sort_report"))
    else:
        _sort(job, scan, path, scan_normals=scan_normals)
    return path


def sort(scan: Any, output: str | os.PathLike, *, texture: Any = None, ids: str = "none",
         channels: Sequence[str] | str = (), embed_textures: bool = False, scan_normals: str = "auto",
         memory: int | str | None = None, threads: int = 0, tmpdir: Any = None,
         progress: Progress | None = None) -> dict:
    """Sorts a scan into a chunk file (.tris), from which all other functions start faster.

    texture: an image for all faces with texture coordinates. ids: "material", "object" or "color".
    channels: such as ("roughness",), or "all" that materials have. scan_normals: of a scan that has none, by
    "area" (auto), "angle", "max" or "flat". Returns the report. Raises Error."""
    with Job(memory, threads, tmpdir, progress) as job:
        return _sort(job, scan, os.fspath(output), texture, ids, channels, embed_textures,
                     scan_normals)


def voxelize(scan: Any, output: str | os.PathLike, *, resolution: int = 2048,
             voxel_size: float | None = None, scan_normals: str = "auto",
             channels: str | None = None, memory: int | str | None = None, threads: int = 0,
             tmpdir: Any = None, progress: Progress | None = None) -> dict:
    """Voxelizes a scan into a grid (.nvdb) of `resolution` voxels along its longest side, or with
    voxels of an edge in the scan's units. Returns the report. Raises Error."""
    with Job(memory, threads, tmpdir, progress) as job:
        options = ffi.new("struct vox_voxelize_options *")
        lib.vox_voxelize_defaults(options)
        options.tris_path = job.string(_chunks(job, scan, scan_normals))
        options.grid_path = job.string(os.fspath(output))
        if voxel_size is not None:
            check_real("voxel_size", voxel_size, 0, np.inf)
        options.resolution = 0 if voxel_size else check_number("resolution", resolution, 1, 2 ** 32 - 1)
        options.voxel_size = voxel_size or 0
        options.scan_normals = _word("scan_normals", scan_normals, NORMALS)
        options.channels = job.string(channels)
        report = _new_report("struct vox_voxelize_report")
        job.run(lib.vox_voxelize, options, report)
        return _plain(report)


def _scan_size(job: Job, chunks: str) -> tuple[int, float]:
    """Returns the triangles of a chunk file and the diagonal of their box."""
    triangles, diagonal = ffi.new("uint64_t *"), ffi.new("double *")
    job.run(lib.vox_scan_size, job.string(chunks), ffi.NULL, triangles, diagonal)
    return triangles[0], diagonal[0]


def _simplify(job: Job, scan: Any, paths: list[str], targets: list[int], **members: Any) -> dict:
    options = ffi.new("struct vox_simplify_options *")
    lib.vox_simplify_defaults(options)
    options.tris_path = job.string(_chunks(job, scan))
    options.output_paths = job.strings(paths)
    options.targets = job.keep(ffi.new("uint64_t[]", targets or [0]))
    options.target_count = len(targets)
    for name, value in members.items():
        setattr(options, name, value)
    report = _new_report("struct vox_simplify_report")
    job.run(lib.vox_simplify, options, report)
    return _plain(report)


def _warn_of_more(job: Job, report: dict, targets: Sequence[Any]) -> None:
    for level, target in zip(report["levels"], targets):
        if level["triangles"] > target:
            job.warnings.append(f"{level['triangles']} triangles instead of {target}: each edge that is left "
                                "would close a hole or join pieces")


def simplify(scan: Any, output: str | os.PathLike | None = None, *, triangles: int | str | None = None,
             error: float | str | None = None, min_component: float | str = 0, min_triangles: int = 0,
             hard_angle: float = 180, memory: int | str | None = None, threads: int = 0, tmpdir: Any = None,
             progress: Progress | None = None) -> Mesh:
    """Makes a low-poly mesh of a number of triangles (or "10%" of the scan's), or with a largest distance
    from the scan, in its units (or "0.1%" of its diagonal).

    output: an .obj or .ply file to write, too. min_component: pieces whose box has a smaller
    percentage of the scan's diagonal are dropped; min_triangles: those of fewer triangles of the scan.
    hard_angle: normals are smooth over edges up to that many degrees. The mesh's `report` has the
    distances both ways. Warns of more triangles than asked for. Raises Error, ValueError."""
    if (triangles is None) == (error is None):
        raise ValueError("simplify: either triangles or error is needed")
    if output and not os.fsdecode(output).lower().endswith((".obj", ".ply")):
        raise ValueError(f"{output}: its name must end in .obj or .ply")
    check_real("hard_angle", hard_angle, 0, 180)
    target = 0 if triangles is None else check_triangles(triangles, 4)
    least, of_diagonal = (0, False) if error is None else parse_amount("error", error)
    component = parse_amount("min_component", str(min_component).removesuffix("%") + "%")[0]
    with Job(memory, threads, tmpdir, progress) as job:
        path = os.fspath(output) if output else job.temporary("low.ply")
        chunks = _chunks(job, scan)
        if isinstance(target, str) or of_diagonal:
            of, diagonal = _scan_size(job, chunks)
            least *= diagonal / 100 if of_diagonal else 1
            if isinstance(target, str):
                target = max(4, round(parse_amount("triangles", target)[0] / 100 * of))
        targets = [] if triangles is None else [target]
        report = _simplify(job, chunks, [path], targets, error=least,
                           min_component=component / 100, hard_angle=hard_angle,
                           min_triangles=check_number("min_triangles", min_triangles, 0, 2 ** 63))
        _warn_of_more(job, report, targets)
        mesh = read_mesh(path)
        mesh.report = {**report, **report.pop("levels")[0]}
        return mesh


def simplify_levels(scan: Any, outputs: Sequence[str | os.PathLike], triangles: Sequence[int], *,
                    min_component: float | str = 0, min_triangles: int = 0, measured: bool = False,
                    memory: int | str | None = None, threads: int = 0, tmpdir: Any = None,
                    progress: Progress | None = None) -> dict:
    """Makes several low-poly meshes, each of the one before, with falling numbers of triangles, as
    .obj or .ply files. measured: their distances are in the report, and more triangles than asked for are a warning.
    Returns the report. Raises Error, ValueError."""
    component = parse_amount("min_component", str(min_component).removesuffix("%") + "%")[0]
    with Job(memory, threads, tmpdir, progress) as job:
        report = _simplify(job, scan, list(map(os.fspath, outputs)), list(triangles), min_component=component / 100,
                           min_triangles=check_number("min_triangles", min_triangles, 0, 2 ** 63),
                           unmeasured=not measured)
        if measured:
            _warn_of_more(job, report, triangles)
        return report


def measure(low: Any, scan: Any, *, boxes: Any = None, memory: int | str | None = None, threads: int = 0,
            tmpdir: Any = None, progress: Progress | None = None) -> dict:
    """Measures how far a mesh is from a scan: from_scan, from all of the scan to the mesh,
    and from_mesh, the other way. boxes: rows of six numbers, the low and the high corner of boxes of
    space; "boxes" then has both for each: mean, rms and p99 of the points in it, and max of all triangles that touch
    it. Raises Error."""
    with Job(memory, threads, tmpdir, progress) as job:
        chunks = _chunks(job, scan)
        mesh = ffi.new("struct vox_temp_tris **")
        rows = np.asarray([] if boxes is None else boxes, float).reshape(-1, 6).tolist()
        found = ffi.new("struct vox_measured_box[]", [{"low": row[:3], "high": row[3:]} for row in rows])
        from_scan, from_mesh = (ffi.new("struct vox_distances *") for _ in range(2))
        job.run(lib.vox_temp_tris_create, mesh)
        try:
            _sort(job, low, job.temporary("mesh.tris"), scan_normals="flat", temporary=mesh[0])
            job.run(lib.vox_measure_mesh, job.string(chunks), ffi.NULL, mesh[0], found, len(rows),
                    from_scan, from_mesh)
        finally:
            lib.vox_temp_tris_close(mesh[0])
        result = {"from_scan": _plain(from_scan), "from_mesh": _plain(from_mesh)}
        if boxes is not None:
            result["boxes"] = [{key: _plain(getattr(box, key)) for key in ("from_scan", "from_mesh")} for box in found]
        return result


# ---- baking ----

class Maps(dict):
    """Maps by name: float32 arrays (height, width[, channels]), rows from the top, with the values
    of the files. `report` has counts, times and what values stand for; `files` the paths."""

    def __init__(self, arrays: dict, report: dict, files: dict, folder: str | None,
                 glb: str | None):
        super().__init__(arrays)
        self.report, self.files, self._glb = report, files, glb
        self._folder = folder
        if folder:
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def save(self, pattern: str | os.PathLike) -> list[str]:
        """Writes the maps; "<MAP>" in the pattern stands for their names. Of a suffix other than that of
        the bake (`format`), .png can be made of OpenEXR maps that have no unit, with 16 bits, as a bake
        does. Returns the paths. Raises ValueError."""
        pattern, saved = os.fspath(pattern), []
        if "<MAP>" not in pattern and len(self.files) > 1:
            raise ValueError(f"{pattern}: several maps need <MAP> in the name")
        suffix, other = Path(pattern).suffix.lower(), []
        for name, path in self.files.items():
            if suffix != Path(path).suffix:
                other.append(name)
                made = (suffix, Path(path).suffix) == (".png", ".exr") and name in self
                if not made or name in self.report["encodings"]:
                    raise ValueError(f"{pattern}: map {name} was baked as {Path(path).suffix[1:]}; "
                                     "bake(format=...) chooses")
        for name, path in self.files.items():
            saved.append(pattern.replace("<MAP>", name))
            if name in other:
                write_png(saved[-1], srgb(self[name]) if name == "color" else self[name])
            else:
                shutil.copyfile(path, saved[-1])
        return saved

    def glb(self, path: str | os.PathLike) -> str:
        """Copies the GLB file: the low-poly mesh with its maps. Returns the path."""
        if not self._glb:
            raise ValueError("bake(glb=True) makes the GLB file")
        return str(shutil.copyfile(self._glb, os.fspath(path)))


def _set_options(job: Job, options: Any, values: dict) -> None:
    """Sets members of struct bake_options by the library's table of options."""
    count = ffi.new("size_t *")
    table = lib.bake_option_rows(count)
    rows = {_text(table[i].member): table[i] for i in range(count[0])}
    types = {lib.BSQ_OPTION_FLAG: "bool *", lib.BSQ_OPTION_COUNT: "uint32_t *",
             lib.BSQ_OPTION_BYTES: "uint64_t *", lib.BSQ_OPTION_NUMBER: "double *",
             lib.BSQ_OPTION_CHOICE: "uint32_t *"}
    for name, value in values.items():
        row = rows.get(name) or rows.get(name + "_path")
        if row is None or row.kind == lib.BSQ_OPTION_LIST:
            raise TypeError(f"bake() has no option {name!r}")
        is_word = isinstance(value, str) and bool(row.words)
        if row.kind in (lib.BSQ_OPTION_COUNT, lib.BSQ_OPTION_CHOICE) and not is_word:
            value = check_number(name, value, 0, 2 ** 32 - 1)
        if row.kind == lib.BSQ_OPTION_NUMBER and not is_word:
            check_real(name, value, -np.inf, np.inf)
        if is_word and row.kind in types:
            word = lib.bsq_option_word(row.words, value.encode())
            if word < 0:
                raise ValueError(f"{name}: {value!r} is none of: {_text(row.words)}")
            value = {lib.BSQ_OPTION_COUNT: 0xffffffff, lib.BSQ_OPTION_NUMBER: -1}.get(row.kind,
                                                                                    word)
        elif row.kind not in types:
            value = job.string(value)
        elif row.kind == lib.BSQ_OPTION_BYTES:
            value = parse_bytes(value)
        at = ffi.cast("char *", options) + row.offset
        ffi.cast(types.get(row.kind, "const char **"), at)[0] = value


def map_names() -> dict[str, int]:
    """Returns the maps of the library, and their numbers."""
    names: dict[str, int] = {}
    while lib.bake_map_name(len(names)):
        names[_text(lib.bake_map_name(len(names)))] = len(names)
    return names


def own_names(maps: str | Sequence[str]) -> list[str]:
    """Returns maps, also "normal, color", by their own names, as "color" for "basecolor". "opacity" stays: it is a
    channel of scans."""
    others = {_text(lib.bake_map_alias(i)): name for name, i in map_names().items() if name != "mask"}
    words = maps.split(",") if isinstance(maps, str) else maps
    try:
        words = [word.strip() for word in words]
    except (TypeError, AttributeError):
        raise ValueError(f"maps: names are needed, not {maps!r}") from None
    return [others.get(word) or word for word in words if word]


def check_maps(maps: Sequence[str]) -> None:
    """Refuses names that are nearly those of maps, by ValueError; all others are channels of the scan."""
    names = map_names()
    for name in maps:
        near = difflib.get_close_matches(name, names, 1, 0.8)
        if name not in names and near:
            raise ValueError(f"maps: there is no map {name!r}; the nearest is {near[0]!r} "
                             f"('transfer:{name}' is the scan's channel)")


def _choose_maps(job: Job, options: Any, maps: Sequence[str]) -> None:
    """Sets the bits of maps; other names are transfer maps, of channels that the scan has."""
    names, transfers = map_names(), []
    maps = own_names(maps)
    check_maps(maps)
    for name in maps:
        if name in names:
            options.maps |= 1 << names[name]
        else:
            transfers.append({"name": job.string(name.removeprefix("transfer:"))})
    options.transfers = job.keep(ffi.new("struct bake_transfer[]", transfers))
    options.transfer_count = len(transfers)


def _scan_paths(job: Job, scan: Any) -> list[str]:
    """Returns the paths of a scan as the library bakes it: grids and chunk files as they are, meshes
    sorted."""
    if not _is_memory(scan) and all(
            _kind(job, path) in (lib.FMT_KIND_TRIS, lib.FMT_KIND_NVDB) for path in _paths(scan)):
        return _paths(scan)
    return [_chunks(job, scan, "auto")]


def _low_path(job: Job, low: Any) -> str:
    if is_path(low):
        return os.fsdecode(low)
    mesh = as_mesh(low)
    if mesh.uvs is None:
        raise ValueError("the low-poly mesh has no texture coordinates: unwrap() makes them")
    path = job.temporary("low.obj")
    mesh.save(path)
    return path


def _arrays_of(job: Job) -> tuple[dict, dict]:
    """Names the maps of a job, by their files if several tiles or objects have one."""
    names = [name for name, _ in job.maps]
    arrays, files = {}, {}
    for (name, path), array in job.maps.items():
        key = name if names.count(name) == 1 else Path(path).stem
        arrays[key], files[key] = array[:, :, 0] if array.shape[2] == 1 else array, path
    return arrays, files


def bake(high: Any, low: Any, maps: Sequence[str] = (), *, size: int | str | tuple = 2048,
         output: str | os.PathLike | None = None, format: str = "exr", glb: bool | str = False,
         memory: int | str | None = None, threads: int = 0, tmpdir: Any = None, arrays: bool = True,
         progress: Progress | None = None, tiles: Sequence[int] = (), **options: Any) -> Maps:
    """Bakes maps of a scan for a low-poly mesh with UVs. Grids (.nvdb) are fast; chunk files and
    meshes give exact maps.

    maps: names such as "normal", "color", "ao"; others are channels of the scan, such as
    "roughness"; (): what the scan has. size: texels, also "4k", or (width, height). output: where files go,
    such as "out/<MAP>.png"; without it, Maps.save() copies temporary ones of `format`, "exr" or
    "png"; None: there are no files. glb: also makes a GLB file, for Maps.glb() or at a path.
    arrays: False keeps no maps in memory. tiles: UDIM tiles to bake. All members of struct
    bake_options are options, such as cage, front, back, samples, sample_type, ao_rays, green_down,
    preview, extrude, device. Raises Error."""
    folder = None
    with Job(memory, threads, tmpdir, progress) as job:
        o = ffi.new("struct bake_options *")
        lib.bake_defaults(o)
        if output is None and (format or glb is True):
            folder = tempfile.mkdtemp(prefix="bisque-", dir=job.tmpdir)
        try:
            paths = _scan_paths(job, high)
            o.scan_path = job.string(paths[0])
            o.more_scan_paths, o.more_scan_count = job.strings(paths[1:]), len(paths) - 1
            o.mesh_path = job.string(_low_path(job, low))
            sides = size if isinstance(size, (tuple, list)) else (size, size)
            if len(sides) != 2:
                raise ValueError(f"size: texels, or (width, height), are needed, not {size!r}")
            o.width, o.height = map(parse_texels, sides)
            o.rows_only = output is None and not format
            if output is None:
                refuse_tokens(folder or job.temporary(""))
            o.output_path = job.string(output or os.path.join(
                folder or job.temporary(""), f"<MAP>.{format or 'exr'}"))
            glb_path = os.path.join(folder or "", "asset.glb") if glb is True else glb
            o.glb_path = job.string(glb_path or None)
            o.tile_ranges = job.keep(ffi.new("struct bake_tile_range[]", [(t, t) for t in tiles]))
            o.tile_range_count = len(tiles)
            if arrays:
                o.on_rows, o.rows_user = lib.on_rows, job.handle
            _set_options(job, o, options)
            _choose_maps(job, o, maps)
            job.run(lib.bake_inspect, o, ffi.NULL, ffi.NULL, ffi.NULL)
            report = _new_report("struct bake_report")
            job.run(lib.bake_run, o, report)
            result = _plain(report)
            lib.bake_report_free(report)
        except BaseException:
            if folder:
                _remove(folder)
            raise
        result["memory_high"] = lib.bsq_memory_high(job.ctx)
        names = map_names()
        result["encodings"] = {name: result["encodings"][i] for name, i in names.items()
                               if result["encodings"][i]["unit"]}
        found, files = _arrays_of(job)
        return Maps(found, result, {} if o.rows_only else files, folder, glb_path or None)


def compare(a: str | os.PathLike, b: str | os.PathLike, *, mask: Any = None, kind: str = "auto",
            heatmap: Any = None, force: bool = False, memory: int | str | None = None, threads: int = 0,
            progress: Progress | None = None) -> dict:
    """Compares two map files: mean, rms, median, p95, p99 and max of the error, in `unit`; kind:
    "normal", "color" or "data". mask: of both, or a list of two. heatmap: a picture to write. Raises
    Error."""
    with Job(memory, threads, None, progress) as job:
        options = ffi.new("struct bake_compare_options *")
        lib.bake_compare_defaults(options)
        options.a_path, options.b_path = job.string(a), job.string(b)
        masks = [mask, mask] if mask is None or is_path(mask) else mask
        options.a_mask_path, options.b_mask_path = map(job.string, masks)
        options.kind = _word("kind", kind, ("auto", "normal", "color", "data"))
        options.heatmap_path = job.string(heatmap)
        options.force = force
        report = _new_report("struct bake_compare_report")
        job.run(lib.bake_compare, options, report)
        return {**_plain(report), "unit": _text(lib.bake_compare_unit(report.kind))}


def sample_image(path: str | os.PathLike, uvs: np.ndarray, *, data: bool, alpha: bool = False,
                 memory: int | str | None = None, threads: int = 0) -> np.ndarray:
    """Filters an image bilinearly at texture coordinates: data as they are, colours in linear light, of
    one that is sRGB, or its alpha three times. Returns float32 (points, 3). Raises Error."""
    with Job(memory, threads) as job:
        uvs = np.ascontiguousarray(uvs, np.float32)
        found = np.empty((len(uvs), 3), np.float32)
        job.run(lib.images_sample, job.string(path), data, alpha, 64 << 20, len(uvs),
                ffi.cast("float (*)[2]", uvs.ctypes.data), ffi.cast("float (*)[3]", found.ctypes.data))
        return found
