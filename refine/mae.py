"""The masked autoencoder that inpaints what a picture of a single action should look like.

A plain ViT on timm's blocks (He et al. 2022; protocol E). The mask is handed in and the loss lives elsewhere. Parameter
names are those of the official checkpoints.
"""

import json
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from timm.models.vision_transformer import Block
from torch import Tensor, nn

from refine.patches import grid_of
from renderers.checks import ShapeError, UserError, check_range, check_shapes


@dataclass(frozen=True)
class MAEConfig:
    """Size of the network and of its pictures."""

    size: int = 64
    """Picture side, pixels."""
    patch: int = 8
    """Patch side, pixels."""
    channels: int = 6
    """Channels of a picture: one for each drawn body part."""
    width: int = 192
    depth: int = 6
    heads: int = 3
    decoder_width: int = 128
    decoder_depth: int = 2
    decoder_heads: int = 4

    def __post_init__(self):
        check_range(self, 1, 4096, *vars(self))
        if self.size % self.patch:
            raise UserError("MAEConfig(patch)", f"a picture of {self.size} px has no whole patches of {self.patch} px")
        for name in ("", "decoder_"):
            width, heads = (getattr(self, name + value) for value in ("width", "heads"))
            if width % heads or width % 4:
                raise UserError(f"MAEConfig({name}width)", f"{width} is not divisible by 4 and by {heads} heads")


def sincos_positions(width: int, grid: tuple[int, int]) -> Tensor:
    """Fixed 2D positions [1 1+P width]: a zero row for cls, then per patch its column in the first half of the
    channels and its row in the second, sines before cosines in each (protocol E.1)."""
    omega = 10000.0 ** (-torch.arange(width // 4, dtype=torch.float64) / (width // 4))
    rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in grid), indexing="ij")
    halves = [
        torch.cat([(at.reshape(-1, 1) * omega).sin(), (at.reshape(-1, 1) * omega).cos()], 1) for at in (columns, rows)
    ]
    table = torch.cat(halves, dim=1)
    return torch.cat([torch.zeros(1, width, dtype=torch.float64), table])[None].float()


class PatchEmbed(nn.Module):
    """Every patch through one linear map, as a strided convolution."""

    def __init__(self, config: MAEConfig):
        super().__init__()
        self.proj = nn.Conv2d(config.channels, config.width, config.patch, config.patch)

    def forward(self, images: Tensor) -> Tensor:
        return self.proj(images).flatten(2).mT


class MAE(nn.Module):
    """forward(images [N C H W] in 0..1, kept [N P] bool) -> predicted patches [N P D]; see ``forward``."""

    def __init__(self, config: MAEConfig | None = None):
        super().__init__()
        self.config = config = config or MAEConfig()
        grid = grid_of((config.size, config.size), config.patch)
        norm = partial(nn.LayerNorm, eps=1e-6)
        block = partial(Block, mlp_ratio=4.0, qkv_bias=True, norm_layer=norm)
        self.patch_embed = PatchEmbed(config)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.width))
        self.register_buffer("pos_embed", sincos_positions(config.width, grid))
        self.blocks = nn.ModuleList(block(config.width, config.heads) for _ in range(config.depth))
        self.norm = norm(config.width)
        self.decoder_embed = nn.Linear(config.width, config.decoder_width)
        self.mask_token = nn.Parameter(torch.zeros(1, 1, config.decoder_width))
        self.register_buffer("decoder_pos_embed", sincos_positions(config.decoder_width, grid))
        self.decoder_blocks = nn.ModuleList(
            block(config.decoder_width, config.decoder_heads) for _ in range(config.decoder_depth)
        )
        self.decoder_norm = norm(config.decoder_width)
        self.decoder_pred = nn.Linear(config.decoder_width, config.patch**2 * config.channels)
        for module in self.modules():
            if isinstance(module, nn.Linear):  # as the official code; torch's own start lies on a plateau for long
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)
        nn.init.normal_(self.decoder_pred.weight, std=1e-3)  # start near an empty picture: most of it is background
        nn.init.normal_(self.cls_token, std=0.02)
        nn.init.normal_(self.mask_token, std=0.02)

    def forward(self, images: Tensor, kept: Tensor) -> Tensor:
        """Predict all patches from the visible ones.

        Args:
            images: [N C H W] in 0..1; pixels outside kept patches have no influence.
            kept: [N P] bool, True = visible; every row keeps the same number of patches.

        Returns:
            [N P D], D = patch * patch * C as ``patches.patchify`` orders it. Visible patches are predicted too, but
            never trained.

        Raises:
            ShapeError: another picture size or channel count, or rows that keep different numbers.
        """
        config = self.config
        tokens = self.pos_embed.shape[1] - 1
        check_shapes(
            "MAE", images=(images, f"N {config.channels} {config.size} {config.size}"), kept=(kept, f"N {tokens}")
        )
        counts = kept.sum(1)
        if (counts != counts[0]).any():
            raise ShapeError("MAE(kept)", f"rows keep {counts.min()} to {counts.max()} patches, expected equal numbers")
        # The order among visible tokens is irrelevant; ascending order puts them back by a masked scatter.
        visible = kept.nonzero()[:, 1].reshape(len(kept), -1)
        x = self.patch_embed(images) + self.pos_embed[:, 1:]
        x = x.gather(1, visible[..., None].expand(-1, -1, x.shape[-1]))
        cls = (self.cls_token + self.pos_embed[:, :1]).expand(len(x), -1, -1)
        x = torch.cat([cls, x], dim=1)
        for block in self.blocks:
            x = block(x)
        x = self.decoder_embed(self.norm(x))
        full = self.mask_token.to(x).expand(len(x), tokens, -1)
        full = full.scatter(1, visible[..., None].expand(-1, -1, x.shape[-1]), x[:, 1:])
        x = torch.cat([x[:, :1], full], dim=1) + self.decoder_pos_embed
        for block in self.decoder_blocks:
            x = block(x)
        return self.decoder_pred(self.decoder_norm(x))[:, 1:]


def load_mae(path: str | Path | None = None) -> MAE:
    """A trained MAE, frozen: ``path`` is a ``.safetensors`` with its ``.json`` beside; none loads the shipped weights.

    Raises:
        UserError: missing or damaged file, or weights that do not fit the configuration beside them.
    """
    weights = Path(str(resources.files("refine") / "assets" / "mae.safetensors")) if path is None else Path(path)
    described = weights.with_suffix(".json")
    for file in (weights, described):
        if not file.is_file():
            raise UserError(
                file, "no such file", "give the .safetensors that `refine train mae` wrote, its .json beside it"
            )
    try:
        mae = MAE(MAEConfig(**json.loads(described.read_text())["config"]))
        mae.load_state_dict({name: value.float() for name, value in load_file(weights).items()})
    except (SafetensorError, json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(
            weights, f"not the weights of an inpainting MAE ({reason})", "train one with `refine train mae`"
        ) from error
    return mae.eval().requires_grad_(False)
