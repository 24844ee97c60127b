"""The masked autoencoder that inpaints what a picture of a single action should look like.

A plain ViT on timm's blocks (He et al. 2022; protocol E). The mask is handed in and the loss lives elsewhere. Parameter
names are those of the official checkpoints, which load as well.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Literal

import torch
from timm.models.vision_transformer import Block
from torch import Tensor, nn

from refine.formats.untrusted import read_json
from refine.formats.weights import check_network, first_line, read_checkpoint, read_safetensors
from refine.patches import grid_of, patchify
from renderers.checks import ShapeError, UserError, check_known, check_range, check_shapes

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))  # mean and standard deviation of red, green, blue
OFFICIAL_HEADS = {768: 12, 1024: 16, 1280: 16}  # by width: the one size that the tensors do not tell
WITH_DECODER = "give one with its decoder, such as mae_visualize_vit_large.pth"


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
    normalisation: Literal["none", "imagenet"] = "none"
    """What the network itself reads and predicts: pictures in 0..1 as they are, or by the mean and deviation of
    ImageNet's colours, as the official networks learned. Outside of it everything stays in 0..1."""

    def __post_init__(self):
        check_range(self, 1, 4096, *(name for name in vars(self) if name != "normalisation"))
        check_known("MAEConfig(normalisation)", self.normalisation, ("none", "imagenet"))
        if self.normalisation == "imagenet" and self.channels != 3:
            raise UserError("MAEConfig(normalisation)", f"ImageNet's colours have 3 channels, not {self.channels}")
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
    """Every patch through one linear map, held as the strided convolution that it is over a whole picture."""

    def __init__(self, config: MAEConfig):
        super().__init__()
        self.proj = nn.Conv2d(config.channels, config.width, config.patch, config.patch)

    def forward(self, patches: Tensor) -> Tensor:
        """[N K D] as ``patches.patchify`` orders them -> [N K width]."""
        return nn.functional.linear(patches, self.proj.weight.permute(0, 2, 3, 1).flatten(1), self.proj.bias)


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
        if config.normalisation == "imagenet":
            # Not in the file, and real even where the weights are made on the meta device to be loaded.
            mean, std = (torch.tensor(values, device="cpu") for values in IMAGENET)
            self.register_buffer("mean", mean, persistent=False)
            self.register_buffer("std", std, persistent=False)
            with torch.no_grad():
                self.decoder_pred.bias.copy_((-mean / std).repeat(config.patch**2))

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
        # The fused kernel's gradient is ten times slower in bfloat16 on a processor.
        fused = images.device.type != "cpu" or not torch.is_autocast_enabled("cpu")
        for block in (*self.blocks, *self.decoder_blocks):
            block.attn.fused_attn = fused
        # The order among visible tokens is irrelevant; ascending order puts them back by a masked scatter.
        visible = kept.nonzero()[:, 1].reshape(len(kept), -1)
        if config.normalisation == "imagenet":
            images = (images - self.mean[:, None, None]) / self.std[:, None, None]
        patches = patchify(images, config.patch)[kept].unflatten(0, visible.shape)
        x = self.patch_embed(patches) + self.pos_embed[0, 1:][visible]
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
        patches = self.decoder_pred(self.decoder_norm(x))[:, 1:]
        if config.normalisation == "imagenet":  # the channel runs fastest in a patch
            patches = (patches.unflatten(-1, (-1, config.channels)) * self.std + self.mean).flatten(-2)
        return patches


def load_mae(path: str | Path | None = None) -> MAE:
    """A trained MAE, frozen; none loads the shipped weights.

    Args:
        path: a ``.safetensors`` of ``refine train mae`` with its ``.json`` beside, or a ``.pth`` in the layout of the
            official repository (facebookresearch/mae), see ``load_official``.

    Raises:
        UserError: missing or damaged file, weights that do not fit the configuration beside them or are not finite,
            an encoder without its decoder.
    """
    weights = Path(str(resources.files("refine") / "assets" / "mae.safetensors")) if path is None else Path(path)
    mae = load_official(weights) if weights.suffix in (".pth", ".pt") else load_described(weights)
    for name, value in mae.state_dict().items():
        if not value.isfinite().all():
            raise UserError(weights, f"{name} holds values that are not finite", "get or train it again")
    return mae.eval().requires_grad_(False)


def load_described(weights: Path) -> MAE:
    """An MAE from safetensors and the description beside it."""
    description = weights.with_suffix(".json")
    remedy = "give the .safetensors that `refine train mae` wrote, its .json beside it"
    for file in (weights, description):
        if not file.exists():
            raise UserError(file, "no such file", remedy)
    stored, described = read_safetensors(weights, remedy)[0], read_json(description, finite=False)
    tensors = {name: value.float() for name, value in stored.items()}
    try:
        config = MAEConfig(**described["config"])
    except (KeyError, TypeError, UserError) as error:
        raise UserError(description, f"describes no inpainting MAE ({first_line(error)})", remedy) from error
    check_network(weights, lambda: MAE(config), config.depth + config.decoder_depth, tensors, remedy)
    mae = MAE(config)
    mae.load_state_dict(tensors)
    return mae


def load_official(weights: Path) -> MAE:
    """An MAE from a checkpoint of the official repository.

    Its own tables of positions are used: they are the ones that the weights were trained with. Files named ``*_full``
    are of networks whose targets were standardised patch by patch (``norm_pix_loss``); nothing inside tells, so the
    name is taken at its word, and a warning given.
    """
    tensors = read_official(weights)
    config = official_config(weights, tensors)
    with torch.device("meta"):
        mae = MAE(config)
    expected = mae.state_dict()
    if wrong := sorted(expected.keys() ^ tensors.keys()):
        some = ", ".join(wrong[:3]) + (", ..." if len(wrong) > 3 else "")
        raise UserError(weights, f"{len(wrong)} tensors are missing or unknown: {some}", WITH_DECODER)
    for name, value in expected.items():
        if tensors[name].shape != value.shape:
            found = f"{name} has the shape {list(tensors[name].shape)}, expected {list(value.shape)}"
            raise UserError(weights, found, WITH_DECODER)
    if weights.stem.endswith("_full"):
        warnings.warn(f"{weights}: predicts patches standardised one by one, which are no pictures", stacklevel=3)
    mae.load_state_dict({name: value.float() for name, value in tensors.items()}, assign=True)
    return mae


def read_official(weights: Path) -> dict[str, Tensor]:
    """The network's tensors of a ``.pth``: those under ``"model"``, or the whole file if it is a plain state dict.

    Nothing in the file is run, see `read_checkpoint`.

    Raises:
        UserError: missing, too large, damaged, holding anything else, or without a decoder.
    """
    if not weights.exists():
        raise UserError(weights, "no such file", "give a checkpoint of the official MAE, or weights of your own")
    found = read_checkpoint(weights, WITH_DECODER)
    tensors = found.get("model", found) if isinstance(found, Mapping) else None
    if not isinstance(tensors, Mapping) or not all(isinstance(value, Tensor) for value in tensors.values()):
        raise UserError(weights, "holds no network's tensors, by themselves or under 'model'", WITH_DECODER)
    if "patch_embed.proj.weight" in tensors and "decoder_pred.weight" not in tensors:
        raise UserError(weights, "is an encoder without its decoder, and cannot inpaint", WITH_DECODER)
    return dict(tensors)


def official_config(weights: Path, tensors: dict[str, Tensor]) -> MAEConfig:
    """The sizes of a network in the official layout, read from its tensors' shapes.

    Heads have 64 channels (but 80 in the largest encoder) and 32 in the decoder.

    Raises:
        UserError: it is no such layout, or not one of square colour pictures.
    """
    try:
        width, channels, patch, _ = tensors["patch_embed.proj.weight"].shape
        if channels != 3:
            raise ValueError(f"it reads pictures of {channels} channels, not of red, green and blue")
        depth, decoder_depth = (
            len({name.split(".")[1] for name in tensors if name.startswith(f"{blocks}.")})
            for blocks in ("blocks", "decoder_blocks")
        )
        decoder_width = tensors["decoder_embed.weight"].shape[0]
        return MAEConfig(
            size=round((tensors["pos_embed"].shape[1] - 1) ** 0.5) * patch,
            patch=patch,
            channels=channels,
            width=width,
            depth=depth,
            heads=OFFICIAL_HEADS.get(width, max(1, width // 64)),
            decoder_width=decoder_width,
            decoder_depth=decoder_depth,
            decoder_heads=max(1, decoder_width // 32),
            normalisation="imagenet",
        )
    except (KeyError, ValueError, IndexError, TypeError, UserError) as error:
        raise UserError(weights, f"is not laid out as an official MAE ({first_line(error)})", WITH_DECODER) from error
