"""A second device, simulated by PyTorch without one: tensors on it and tensors on the CPU must not meet.

Data stay on the CPU. Every storage carries a tag: `Tensor.device` answers cuda:0 for tagged ones; `to`, `cpu`, `cuda`
and factories with `device=` move the tag. An operation whose operands carry different tags raises `MixedDevicesError`,
and so does `numpy()` of a tagged tensor. As on a real GPU, CPU tensors without dimensions and CPU indices are allowed.

    with SecondDevice():
        model.to("cuda")(images.to("cuda")).sum().backward()

Not simulated: kernels, streams, memory, dtype support. Written against PyTorch 2.13.
"""

import torch
from torch.autograd.graph import _engine_run_backward
from torch.nn import functional
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes
from torch.utils._pytree import tree_leaves

CUDA, CPU = torch.device("cuda", 0), torch.device("cpu")
MIXING = {"copy_", "_to_copy", "set_", "is_same_size"}
INDEXING = {"index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index", "_unsafe_index_put"}


class MixedDevicesError(RuntimeError):
    """Raised when operands are on different devices."""


def storage(tensor):
    """Return the memory that carries a tensor's tag."""
    with torch._C.DisableTorchFunction(), _disable_current_modes():
        if tensor.layout is torch.sparse_coo:
            tensor = tensor._values()
        elif tensor.layout is not torch.strided:
            tensor = tensor.values()
        return tensor.untyped_storage()


def tagged(tensor):
    """Return whether a tensor is on the second device."""
    return getattr(storage(tensor), "second_device", False)


def tag(tensor, on):
    """Put a tensor's memory on the second device, or on the CPU, and return the tensor."""
    storage(tensor).second_device = on
    return tensor


def is_cuda(device):
    """Return whether a device, as `to` takes it, is the second one."""
    return isinstance(device, int) or torch.device(device).type == "cuda"


class _Operations(TorchDispatchMode):
    """Checks the operands of every operation and tags what it returns."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        tensors = [leaf for leaf in tree_leaves((args, kwargs or {})) if isinstance(leaf, torch.Tensor)]
        tags, name = [tagged(tensor) for tensor in tensors], func.overloadpacket.__name__
        if any(tags) and name not in MIXING and not (name in INDEXING and tags[0]):
            operands = [(tensor, on) for tensor, on in zip(tensors, tags, strict=True) if tensor.dim() > 0]
            if operands and not all(on for _, on in operands):
                shapes = ", ".join(f"{tuple(tensor.shape)} {'cuda' if on else 'cpu'}" for tensor, on in operands)
                raise MixedDevicesError(f"{func}: {shapes}")
        out = func(*args, **(kwargs or {}))
        if name not in ("copy_", "set_"):
            on = tags[0] if name == "_to_copy" and tags else any(tags)
            known = {storage(tensor)._cdata for tensor in tensors}
            for leaf in tree_leaves(out):
                if isinstance(leaf, torch.Tensor) and storage(leaf)._cdata not in known:
                    tag(leaf, on)
        return out


class SecondDevice(TorchFunctionMode):
    """Answers questions about devices and moves tags; see the module."""

    def __init__(self):
        super().__init__()
        self.operations = []

    def __enter__(self):
        self.operations.append(_Operations())
        self.operations[-1].__enter__()
        return super().__enter__()

    def __exit__(self, *error):
        super().__exit__(*error)
        self.operations.pop().__exit__(*error)

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs, name = dict(kwargs or {}), getattr(func, "__name__", "")
        if func == torch.Tensor.device.__get__:
            return CUDA if tagged(args[0]) else func(*args)
        if func == torch.Tensor.is_cuda.__get__:
            return tagged(args[0])
        if func == torch.Tensor.is_cpu.__get__:
            return not tagged(args[0])
        if name in ("numpy", "__array__") and tagged(args[0]):
            raise MixedDevicesError("a tensor of cuda:0 cannot be converted to numpy; use Tensor.cpu() first")
        if func is torch.Tensor.cpu:
            return self.move(args[0], False)
        if func is torch.Tensor.cuda:
            return self.move(args[0], True)
        if func is torch.Tensor.pin_memory:
            return args[0]
        if func is torch.Tensor.to:
            return self.to(*args, **kwargs)
        if func is torch.Tensor.backward:
            loss, gradient = args[0], kwargs.get("gradient")
            if gradient is None:
                with torch._C.DisableTorchFunction():
                    gradient = torch.ones_like(loss.detach())
                tag(gradient, tagged(loss))
            keep, create = bool(kwargs.get("retain_graph")), bool(kwargs.get("create_graph"))
            with self:  # custom backward functions see this device as well
                return _engine_run_backward(
                    (loss,), (gradient,), keep, create, (), allow_unreachable=True, accumulate_grad=True
                )
        if func is functional.embedding_bag and args[0].dim() == 2 and tagged(args[0]):
            # its Python part makes offsets where this mode does not see it
            bags, weights = args[0], kwargs.get("per_sample_weights")
            with torch._C.DisableTorchFunction():
                offsets = torch.arange(0, bags.numel(), bags.shape[1])
            weights = None if weights is None else weights.reshape(-1)
            mode = {"sum": 0, "mean": 1, "max": 2}[kwargs.get("mode", "mean")]
            return torch.embedding_bag(args[1], bags.reshape(-1), tag(offsets, True), False, mode, False, weights)[0]
        if kwargs.get("device") is not None and name != "Generator":
            on = is_cuda(kwargs["device"])
            out = func(*args, **(kwargs | {"device": CPU}))
            shared = args and isinstance(args[0], torch.Tensor) and storage(args[0])._cdata == storage(out)._cdata
            return tag(out.clone() if shared and tagged(args[0]) != on else out, on)
        if name == "new_tensor":
            return tag(func(*args, **kwargs), tagged(args[0]))
        if name in ("from_numpy", "frombuffer", "tensor"):
            return tag(func(*args, **kwargs), False)
        return func(*args, **kwargs)

    def to(self, tensor, *options, non_blocking=False, device=None, other=None, **kwargs):
        """Do what `Tensor.to` does."""
        options, target = [option for option in options if option is not None], None
        for index, option in enumerate(options):
            if isinstance(option, torch.Tensor):
                target, options[index] = tagged(option), option.dtype
                break
            if isinstance(option, (str, torch.device)) or (isinstance(option, int) and not isinstance(option, bool)):
                target = is_cuda(options.pop(index))
                break
        if device is not None:
            target = is_cuda(device)
        if other is not None:
            target, kwargs["dtype"] = tagged(other), other.dtype
        if options and isinstance(options[0], bool):
            options = []
        with torch._C.DisableTorchFunction():
            out = tensor.to(*options, **kwargs) if options or kwargs else tensor
        if out is not tensor and storage(out)._cdata != storage(tensor)._cdata:
            tag(out, tagged(tensor))
        return out if target is None else self.move(out, target)

    def move(self, tensor, on):
        """Return a tensor on the second device or on the CPU, copied if it is on the other one."""
        if tagged(tensor) == on:
            return tensor
        with torch._C.DisableTorchFunction():
            return tag(tensor.clone(), on)
