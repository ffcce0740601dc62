"""Files of weights as `torch.save` writes them since version 1.6, made without torch.

A zip archive, nothing packed: NAME/data.pkl, a pickle of protocol 2 in which a tensor is a call of
torch._utils._rebuild_tensor_v2 with a persistent id (storage, kind, key, place, numbers); in NAME/
data/KEY the numbers; NAME/version; NAME/byteorder. Parameters are wrapped once more.
"""

import base64
import io
import pickle
import sys
import types
import zipfile
import zlib
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


def saved_by_torch():
    """A file that torch 2.11 saved of tensors on a GPU: see `test_a_file_of_torch_itself`."""
    return zlib.decompress(base64.b85decode(SAVED))


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
    from rainsim.scene.splat_sets import joined

    weights = gaussian_weights(joined(parts), **options)
    weights["instances_quats"] = Parameter(np.asarray(turns, np.float32))
    weights["instances_trans"] = Parameter(np.asarray(places, np.float32))
    owner = np.concatenate([np.full((len(p), 1), k) for k, p in enumerate(parts)])
    weights["points_ids"] = owner.astype(np.int64)
    weights["instances_size"] = np.asarray(sizes, np.float32)
    weights["instances_fv"] = np.asarray(there, bool)
    return weights


# A module's state_dict (a parameter, halves, a buffer of booleans), a number, a transposed part of
# a tensor, a torch.Size, a list and a scalar tensor; packed by zlib, as base 85.
SAVED = (
    "c-o~_O>Y}T7@l1_cCvBOq)D2VKq-_D2ij!qwPPnVU)!>PmXE|0$f|^_jlGFiY`l5B;}j|^1yzZ}l^;+zbLx#7iZ~"
    "aE1_^QCfW(Ot;(&xWF*7@MXE$Gzjx%|^@jTD_%*^{f&Wag}Bh=fA4vhgchMKnJPS-4KO>KST8u~E06&*Wr8&JBOA"
    "b?G;X1hK}ZIH_nd0vKCwd%R9UB!;q@Rj$PHM?ooZa7t}Kzy<UJprz=X<H2+5>@OqtM#c$3p=i_RGRi$%W-QJY&U$"
    "bS=r7ikW8n`NrLdnN^8T0-T<N)u4mz!!5<aqW7$<u7<;u<v*uLjH&Yl=t0pqzW^4}z%$O<d!Qkh0D&!1?p%M%;Tp"
    "iBVNuGL#`%TMT?^2JjB^ekMsmDwO!#PUbW6FClZpxJUd_a8x!&4=gV7N7SIz+8|p4+8<hAqj$MUnbhQ^s(KQp>yW"
    "oGI<X^8xK;3@?=6#a0_$D)$9vh%I_i@G|>6U8YwElWll~o!GYB^vNZ_tES}p{+eHovtzWk;L1B{i#=^S_HDQt68N"
    "^)*yswJVgfaoF2|_Atrn=}c?_9VQzAQ#??INlN$i0ZD9mBVmtZDH<lM2Lz)5eC2L+1c9?0U^U6?DuYiyP4_!zEz2"
    "=nPT7XJ=vkfpR>;a!_0^|ml9wqdC()8$QA4%F6z8_$7WS4|1Sb#h>nlYxvI7+x=d;kTw%%w+G~zdrr(YXYWo<=Dy"
    "}B`;R_Q|n%H)4~;gdWJr9r~xvR_M1O`xl0w$c|7enn&Y&*ek+#iY&16Q1~&AW!>#q7#!QY1SiB9t(=(Az6flVNK)"
    "~83*!E~Q8v4Tj%-b2RgRyH<4ZHKdU7)3#I8j4CT7Kjz)2gA*Kbe4lb!U<MS|UGW?vVKvnfqk^x<q{lp&>Fak*O|I"
    "r60G~7gTByrzjm4lx7Tl<S3=++Tj<?k$UUr&qi4-ot#4xa%2sC`f*P~LNwdAm%l5Ye*gWbN64lbx`b|ZK9hKqd5r"
    "NG=dp*!1dmA`J8AlORJyr>k?MY%bZRgdXLuaqahS)mJdSjGF&JY!p6fPKFzD`Q?|WbFllS|l>^>>%K4<7Lde+}Rc"
    "rZ^n?w9_Q<9xrzbEG;Q)OCa>?H^5{*&p89c>nbKn?QMPAZ!c1-E@e9+_C7_YsIM<dgk%PsA@i+nN>5zyp~n9{H$6"
    "i7F4yMX~oR!%uF_4PzwbuS7a`umJV8Jq9e^zN~}~mIz?w4IHWxEe?$~2y60#J_K%E?G~y_OXn*4&hSeB4&U2$AqJ"
    "IsBNDewAUEhpiMMvomVLyl?(eI)_(I&z`+Hr#YM1f+*hk>;aFdGGm%@PJ4gn(KUD0WB~_(MVj=AuBcxKrUT+9V3K"
    "Qxqu{+(ZcZMF)9wE3BA_#1+2uV(hBm0pWO$+g-7@<0c7aY(FWFTye$hNd%aFwmw+<FENfb`v"
)
