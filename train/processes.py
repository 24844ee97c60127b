"""One run on several processes, as ``torchrun`` starts them.

The processes draw the same batches and hold the same weights. Each takes its part of a batch, the gradients are summed,
and all take the same step; the first one measures and writes.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed, nn

from renderers.checks import UserError

SAY = 2.0  # seconds that the others live on after a refusal: the launcher ends all as soon as one ends


@dataclass(frozen=True)
class Processes:
    """This process among its peers; alone it is the first of one."""

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        return self.rank == 0

    def sum(self, values: list[Tensor]):
        """Replace tensors by their sums over all processes."""
        if self.count > 1:
            flat = torch.cat([value.flatten() for value in values])
            distributed.all_reduce(flat)
            for value, summed in zip(values, flat.split([value.numel() for value in values]), strict=True):
                value.copy_(summed.view_as(value))

    def sum_gradients(self, model: nn.Module):
        """Replace the gradients of a model by their sums; one that a process lacks counts as zero."""
        if self.count > 1:
            learned = [parameter for parameter in model.parameters() if parameter.requires_grad]
            for parameter in learned:
                parameter.grad = torch.zeros_like(parameter) if parameter.grad is None else parameter.grad
            self.sum([parameter.grad for parameter in learned])

    def wait(self):
        """Until all processes are here."""
        if self.count > 1:
            distributed.barrier()

    @contextmanager
    def agreeing(self) -> Iterator[None]:
        """A block in which the first process may refuse the run for all.

        Raises:
            UserError: the first process's own; on the others one that nobody reads.
        """
        refusal = None
        try:
            yield
        except UserError as error:
            refusal = error
        if self.count > 1:
            refused = torch.tensor([int(refusal is not None)], device=self._device())
            distributed.broadcast(refused, 0)
            if refused and not self.first:
                raise UserError("process 0", "refused the run")
        if refusal:
            raise refusal

    @staticmethod
    def _device() -> str:
        return "cuda" if distributed.get_backend() == "nccl" else "cpu"


def launched() -> Processes:
    """What ``torchrun`` says of this process."""
    return Processes(int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1)))


@contextmanager
def together(device: str) -> Iterator[tuple[Processes, str]]:
    """The processes of this run, connected, and the device of this one: of ``cuda`` each has a card to itself.

    A refusal is worded by the first process alone, and ends all with exit code 2.
    """
    processes = launched()
    if processes.count == 1:
        yield processes, device
        return
    if device == "cuda":
        device = f"cuda:{os.environ['LOCAL_RANK']}"
        torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    try:
        yield processes, device
    except UserError as error:
        if processes.first:
            raise
        time.sleep(SAY)
        raise SystemExit(2) from error
    finally:
        distributed.destroy_process_group()
