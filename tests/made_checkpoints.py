"""Files of weights as `torch.save` writes them since version 1.6, made without torch.

A zip archive, nothing packed: NAME/data.pkl, a pickle of protocol 2 in which a tensor is a call of
torch._utils._rebuild_tensor_v2 with a persistent id (storage, kind, key, place, numbers); in NAME/
data/KEY the numbers; NAME/version; NAME/byteorder. Parameters are wrapped once more.
"""

import io
import pickle
import sys
import types
import zipfile
from collections import OrderedDict

import numpy as np

KINDS = {"f4": "FloatStorage", "f8": "DoubleStorage", "i8": "LongStorage", "b1": "BoolStorage"}


def _stand_ins():
    """Modules that pickle finds torch's names in."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")
    for name in KINDS.values():
        setattr(torch, name, type(name, (), {"__module__": "torch"}))
    for name in ("_rebuild_tensor_v2", "_rebuild_parameter"):
        function = types.FunctionType((lambda *a: None).__code__, {}, name)
        function.__module__, function.__qualname__ = "torch._utils", name
        setattr(utils, name, function)
    return {"torch": torch, "torch._utils": utils}


class Parameter:
    """An array that is saved as a parameter."""

    def __init__(self, values):
        self.values = values


class _Storage:
    def __init__(self, values):
        self.values = values


class _Pickler(pickle.Pickler):
    def __init__(self, file, modules):
        super().__init__(file, 2)
        self._modules, self.storages = modules, []

    def persistent_id(self, value):
        if not isinstance(value, _Storage):
            return None
        flat = value.values.ravel()
        kind = getattr(self._modules["torch"], KINDS[flat.dtype.str[1:]])
        self.storages.append(flat)
        return "storage", kind, str(len(self.storages) - 1), "cuda:0", len(flat)

    def reducer_override(self, value):
        utils = self._modules["torch._utils"]
        if isinstance(value, Parameter):
            return utils._rebuild_parameter, (value.values, True, OrderedDict())
        if isinstance(value, np.ndarray):
            stride = tuple(n // value.itemsize for n in value.strides)
            whole = _Storage(np.ascontiguousarray(value))
            stride = tuple(n // value.itemsize for n in whole.values.strides) or stride
            given = whole, 0, value.shape, stride, False, OrderedDict()
            return utils._rebuild_tensor_v2, given
        return NotImplemented


def torch_file(data, name="archive"):
    """Bytes of the file that torch.save writes of nested dicts and lists of arrays."""
    modules = _stand_ins()
    before = {key: sys.modules.get(key) for key in modules}
    sys.modules.update(modules)
    try:
        index = io.BytesIO()
        pickler = _Pickler(index, modules)
        pickler.dump(data)
    finally:
        for key, module in before.items():
            if module is None:
                del sys.modules[key]
            else:
                sys.modules[key] = module
    return archive_of(index.getvalue(), pickler.storages, name)


def archive_of(index, storages=(), name="archive", compression=zipfile.ZIP_STORED):
    """Bytes of an archive with an index (a pickle) and the numbers of storages."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        archive.writestr(f"{name}/data.pkl", index)
        archive.writestr(f"{name}/byteorder", "little")
        for key, values in enumerate(storages):
            archive.writestr(f"{name}/data/{key}", values.tobytes())
        archive.writestr(f"{name}/version", "3\n")
    return out.getvalue()


def gaussian_weights(splats, degree_0=False):
    """The weights of one class of drivestudio's Gaussians, as its state_dict names them."""
    logit = np.log(splats.opacity / (1 - splats.opacity))[:, None]
    base, rest = splats.sh[:, 0], splats.sh[:, 1:]
    if degree_0:
        color = np.clip(0.5 + 0.28209479177387814 * base, 1e-3, 1 - 1e-3)
        base, rest = np.log(color / (1 - color)), rest[:, :0]
    arrays = {"_means": splats.position, "_scales": np.log(splats.scale), "_quats": splats.rotation,
              "_features_dc": base, "_features_rest": rest, "_opacities": logit}  # fmt: skip
    weights = OrderedDict((k, Parameter(np.asarray(v, np.float32))) for k, v in arrays.items())
    weights._metadata = OrderedDict({"": {"version": 1}})  # as modules of torch add it
    return weights


def node_weights(parts, sizes, places, turns, there, **options):
    """The weights of a class of nodes: `parts` lists the Splats of each node."""
    from rainsim.scene.actors import joined

    weights = gaussian_weights(joined(parts), **options)
    weights["instances_quats"] = Parameter(np.asarray(turns, np.float32))
    weights["instances_trans"] = Parameter(np.asarray(places, np.float32))
    owner = np.concatenate([np.full((len(p), 1), k) for k, p in enumerate(parts)])
    weights["points_ids"] = owner.astype(np.int64)
    weights["instances_size"] = np.asarray(sizes, np.float32)
    weights["instances_fv"] = np.asarray(there, bool)
    return weights
