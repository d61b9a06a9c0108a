"""Files as they are sent from one person to another, changed at random: in their bytes, and in what they say."""

import copy
import io
import json
import zipfile

import h5py
import numpy as np

#: What stands where something else did.
ODD = (
    None, True, False, "", "x", "nan", "1e999", "9" * 400, -1, 0, 1.5, 1e300, float("nan"), float("inf"), 10**400, [],
    {}, [[]], {"a": 1}, "degenerate|nonsense", "é\0\n", "\ud800", "2024-13-45",
)  # fmt: skip
DEEP = "[" * 3000 + "]" * 3000


def choose(rng, options):
    return options[rng.integers(len(options))]


def bytes_changed(rng, content):
    """Some bytes changed, a piece left out or doubled, or the end cut."""
    content = bytearray(content)
    kind, at = rng.integers(4), int(rng.integers(len(content)))
    if kind == 0:
        return bytes(content[:at])
    if kind == 1:
        end = at + int(rng.integers(1, 200))
        return bytes(content[:at] + content[at:end] * int(rng.integers(3)) + content[end:])
    for k in rng.integers(min(len(content), 2000) if kind == 2 else len(content), size=rng.integers(1, 9)):
        content[k] = int(rng.integers(256))
    return bytes(content)


def tree_changed(rng, tree):
    """A tree, as JSON has it, with one part that is another, is missing, or stands there twice."""
    tree = copy.deepcopy(tree)
    node = tree
    while True:
        keys = [*node] if isinstance(node, dict) else [*range(len(node))]
        if not keys:
            return tree
        key = choose(rng, keys)
        if isinstance(node[key], dict | list) and rng.random() < 0.8:
            node = node[key]
            continue
        kind = rng.integers(6)
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[f"{key}2"] = node.pop(key)
        elif kind == 2 and isinstance(node, list):
            node.insert(key, node[key])
        else:
            node[key] = choose(rng, ODD)
        return tree


def json_changed(rng, content):
    kind = rng.random()
    if kind < 0.1:
        return choose(rng, (DEEP, "[" * 200_000, "null", "[]", "{}", '{"a":' * 50_000, "1" * 5000)).encode()
    if kind < 0.3:
        return bytes_changed(rng, content)
    return json.dumps(tree_changed(rng, json.loads(content))).encode()


def _array_changed(rng, array):
    kind, array = rng.integers(9), np.array(array)
    if kind == 0:
        return array[: len(array) // 2] if array.ndim else array
    if kind == 1:
        return array.reshape(array.shape[::-1])
    if kind == 2:
        return array.ravel()
    if kind == 3:
        texts = array.dtype.kind == "U"
        return array.astype(choose(rng, ("U3", "S40") if texts else ("f4", "f8", "i1", "U3", "S4", "c16", "M8[us]")))
    if kind == 4:
        return np.zeros(choose(rng, ((), (0,), (1, 1), (2, 3, 4), (0, 10**9))), array.dtype)
    if kind == 5 and array.ndim:
        return np.concatenate([array, array])
    if array.size and array.dtype.kind in "iuf":
        info = np.finfo(array.dtype) if array.dtype.kind == "f" else np.iinfo(array.dtype)
        values = [info.min, info.max, 0, 1] + [np.nan, np.inf, -np.inf] * (array.dtype.kind == "f")
        array.flat[rng.integers(array.size)] = choose(rng, values)
    if array.size and array.dtype.kind == "U":
        array = array.astype("U400")
        array.flat[rng.integers(array.size)] = str(choose(rng, ODD))
    return array


def _declared(array, shape):
    """The ``.npy`` of an array whose header declares another shape."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": array.dtype.str, "fortran_order": False, "shape": shape})
    return file.getvalue() + array.tobytes()


def npz_changed(rng, content):
    if rng.random() < 0.25:
        return bytes_changed(rng, content)
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name, file = choose(rng, [*arrays]), io.BytesIO()
    kind, array = rng.integers(5), arrays.pop(name)
    if kind == 0 and "head" in arrays | {name: 0}:
        head = json.loads(str(arrays.pop("head", array)))
        if name != "head":
            arrays[name] = array
        name, array = "head", np.array(choose(rng, (json.dumps(tree_changed(rng, head)), DEEP, "[]", "1" * 5000)))
    elif kind > 1:
        array = _array_changed(rng, array)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in arrays.items():
            archive.writestr(f"{key}.npy", _declared(value, value.shape))
        if kind == 1:
            shape = choose(rng, ((10**12,), (0,), (10**6, 10**6), (1,) * 20, (2,), (-1,), (0, 10**12)))
            archive.writestr(f"{name}.npy", _declared(array, shape))
        elif rng.random() < 0.9:
            archive.writestr(f"{name}.npy", _declared(array, array.shape))
    return file.getvalue()


_YAML_ODD = (
    "true", ".nan", ".inf", "9" * 5000, "2024-13-45", "2001-01-01", "!!python/object:os.system x", "!!binary x", "*a",
    "&a [1]", "0x_", "1:60:60", "[" * 2000, "{" * 2000, "- " * 2000, "~", "? a", "'", '"', "|", "\t", "\0", "<<: *a",
    "%YAML 9.9", "---", "...", "1e400", "-0", "1_000", "!!float x", "!!timestamp 9999-99-99", "x" * 100_000,
)  # fmt: skip
_BOMB = "\n".join(f"a{k}: &a{k} [{','.join([f'*a{k - 1}' if k else 'x'] * 10)}]" for k in range(9))


def yaml_changed(rng, content):
    kind = rng.random()
    if kind < 0.2:
        return bytes_changed(rng, content)
    if kind < 0.25:
        return choose(rng, (_BOMB, _BOMB + "\n" + content.decode(), "#" * (1 << 21), "a: [" * 9000)).encode()
    lines = content.decode().split("\n")
    at = int(rng.integers(len(lines)))
    if kind < 0.4:
        lines[at : at + 1] = lines[at : at + 1] * int(rng.integers(3))
    else:
        words = lines[at].split(" ")
        words[rng.integers(len(words))] = choose(rng, _YAML_ODD)
        lines[at] = " ".join(words)
    return "\n".join(lines).encode()


_SHAPES = ((10**12,), (0,), (1,), (5, 4), (10**6, 10**6), ())


def hdf5_changed(rng, content):
    if rng.random() < 0.4:
        return bytes_changed(rng, content)
    file = io.BytesIO(content)
    with h5py.File(file, "r+") as opened:
        found = []
        opened.visititems(lambda name, node: found.append(name) if isinstance(node, h5py.Dataset) else None)
        name = choose(rng, found)
        node, kind = opened[name], rng.integers(8)
        whole = node[()]
        if kind == 0 and node.maxshape[:1] == (None,):
            node.resize(int(choose(rng, (10**12, 10 * node.shape[0], 1, 0))), axis=0)
        elif kind == 1:
            holder = choose(rng, (opened, opened["events"], opened["events/t"]))
            key = choose(rng, ("unit", "time_unit", "sensor_width", "width", "geometry", "sensor_resolution"))
            value = choose(
                rng, ("x", 1e300, [1, 2, 3], -1, 4000, 65536, "4000x4000", b"\xff", "9" * 400, [], np.bool_(True))
            )
            holder.attrs[key] = value
            holder.attrs[key.replace("width", "height")] = value
        else:
            del opened[name]
            if kind == 2:
                opened.create_dataset(name, choose(rng, _SHAPES[:5]), dtype=choose(rng, ("i8", "f8")), chunks=True)
            elif kind == 3:
                size = choose(rng, (1 << 20, 1 << 28))
                opened.create_dataset(name, (len(whole) if whole.ndim else 5,), "i8", chunks=(size,), maxshape=(None,))
            elif kind == 4:
                opened.create_group(name)
            elif kind == 5:
                changed = _array_changed(rng, whole)
                opened[name] = changed if changed.dtype.kind in "iufSV" else changed.shape
            elif kind == 6:
                opened[name] = h5py.SoftLink(choose(rng, ("/events", f"/{name}", "/nowhere")))
            else:
                opened[name] = choose(rng, ("text", [b"a", b"b"], 3, h5py.Empty("f8"), np.zeros(3, "V8")))
    return file.getvalue()
