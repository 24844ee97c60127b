"""The inpainter: geometry of its tokens, what may and may not influence it, its files (protocol E, G.13)."""

import argparse
import json
import zipfile
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

from refine.mae import MAE, MAEConfig, load_mae, official_config, sincos_positions
from refine.patches import keep_random, patchify, unpatchify
from renderers.checks import ShapeError, UserError

SMALL = MAEConfig(size=32, width=48, depth=2, heads=3, decoder_width=32, decoder_depth=1, decoder_heads=2)


@pytest.fixture
def mae():
    torch.manual_seed(0)
    return MAE(SMALL).eval()


@pytest.fixture
def pictures(generator):
    return torch.rand(2, 6, 32, 32, generator=generator)


@pytest.fixture
def kept(generator):
    return keep_random(2, 16, 1 / 3, generator)


def official_tensors(width, depth, decoder_width, decoder_depth, patch, grid, device="cpu"):
    """Random tensors under the names and in the shapes of an official checkpoint, with its tables of positions."""
    depth_of, pixels = {"blocks": (width, depth), "decoder_blocks": (decoder_width, decoder_depth)}, 3 * patch * patch
    shapes = {
        "cls_token": (1, 1, width),
        "mask_token": (1, 1, decoder_width),
        "patch_embed.proj.weight": (width, 3, patch, patch),
        "patch_embed.proj.bias": (width,),
        "decoder_embed.weight": (decoder_width, width),
        "decoder_embed.bias": (decoder_width,),
        "decoder_pred.weight": (pixels, decoder_width),
        "decoder_pred.bias": (pixels,),
    }
    shapes |= {f"{name}.{kind}": (wide,) for name, wide in (("norm", width), ("decoder_norm", decoder_width))
               for kind in ("weight", "bias")}  # fmt: skip
    for blocks, (wide, count) in depth_of.items():
        for n in range(count):
            for name, out, into in (("attn.qkv", 3, 1), ("attn.proj", 1, 1), ("mlp.fc1", 4, 1), ("mlp.fc2", 1, 4)):
                shapes[f"{blocks}.{n}.{name}.weight"] = (out * wide, into * wide)
                shapes[f"{blocks}.{n}.{name}.bias"] = (out * wide,)
            for name in ("norm1", "norm2"):
                shapes |= {f"{blocks}.{n}.{name}.{kind}": (wide,) for kind in ("weight", "bias")}
    tensors = {name: 0.1 * torch.randn(shape, device=device) for name, shape in shapes.items()}
    for name, wide in (("pos_embed", width), ("decoder_pos_embed", decoder_width)):
        tensors[name] = sincos_positions(wide, (grid, grid)).to(device)
    return tensors


@pytest.fixture
def official():
    torch.manual_seed(0)
    return official_tensors(64, 2, 64, 1, 8, 4)


@pytest.fixture
def colours(generator):
    return torch.rand(2, 3, 32, 32, generator=generator)


def test_positions():
    table = sincos_positions(192, (14, 14))[0]
    assert table.shape == (197, 192) and not table[0].any()
    assert table[2, 0] == pytest.approx(0.841471) and table[2, 96] == 0
    assert table[15, 0] == 0 and table[15, 96] == pytest.approx(0.841471)


def test_size_of_the_published_small_network():
    tensors = MAE(MAEConfig(channels=3)).state_dict()
    assert sum(value.numel() for value in tensors.values()) == 3_174_016


@pytest.mark.parametrize(
    "width, depth, heads, patch, tensors, numbers",
    [(768, 12, 12, 16, 254, 111_907_840), (1024, 24, 16, 16, 398, 329_541_888), (1280, 32, 16, 14, 494, 657_074_508)],
)
def test_sizes_of_the_official_networks(width, depth, heads, patch, tensors, numbers):
    published = official_tensors(width, depth, 512, 8, patch, 224 // patch, device="meta")
    assert (len(published), sum(value.numel() for value in published.values())) == (tensors, numbers)
    config = official_config("file", published)
    assert config == MAEConfig(224, patch, 3, width, depth, heads, 512, 8, 16, "imagenet")
    with torch.device("meta"):
        ours = MAE(config).state_dict()
    assert {name: value.shape for name, value in ours.items()} == {n: value.shape for n, value in published.items()}


def test_forward_is_the_published_one_whatever_the_order_of_the_visible(mae, pictures, kept, generator):
    """Token by token: place, encode, norm, narrow, put back among mask tokens, place, decode, norm, predict."""

    def normed(x, layer):
        return torch.nn.functional.layer_norm(x, x.shape[-1:], layer.weight, layer.bias, eps=1e-6)

    weight, bias = mae.patch_embed.proj.weight.flatten(1), mae.patch_embed.proj.bias
    visible = kept[1].nonzero()[:, 0]
    visible = visible[torch.randperm(len(visible), generator=generator)].tolist()
    tokens = [mae.cls_token[0, 0]]
    for patch in visible:
        top, left = 8 * (patch // 4), 8 * (patch % 4)
        pixels = pictures[1, :, top : top + 8, left : left + 8].flatten()
        tokens.append(weight @ pixels + bias + mae.pos_embed[0, 1 + patch])
    x = torch.stack(tokens)[None]
    for block in mae.blocks:
        x = block(x)
    x = mae.decoder_embed(normed(x, mae.norm))[0]
    full = [x[0], *(x[1 + visible.index(n)] if n in visible else mae.mask_token[0, 0] for n in range(16))]
    x = torch.stack(full)[None] + mae.decoder_pos_embed
    for block in mae.decoder_blocks:
        x = block(x)
    expected = mae.decoder_pred(normed(x, mae.decoder_norm))[0, 1:]
    assert torch.allclose(mae(pictures, kept)[1], expected, atol=1e-6)


def test_masked_pixels_have_no_influence(mae, pictures, kept):
    patches = mae(pictures, kept)
    assert patches.shape == (2, 16, 8 * 8 * 6)
    hidden = (~kept).reshape(2, 1, 4, 4).repeat_interleave(8, 2).repeat_interleave(8, 3)
    changed = torch.where(hidden, torch.rand_like(pictures), pictures)
    assert torch.equal(mae(changed, kept), patches)
    assert not torch.equal(mae(torch.where(hidden, pictures, pictures * 0.5), kept), patches)


def test_where_a_patch_stands_matters(mae, pictures):
    kept = torch.zeros(2, 16, dtype=torch.bool)
    kept[0, [0, 1]] = kept[1, [0, 1]] = True
    swapped = pictures.clone()
    swapped[:, :, :8, :8], swapped[:, :, :8, 8:16] = pictures[:, :, :8, 8:16], pictures[:, :, :8, :8]
    assert not torch.allclose(mae(pictures, kept), mae(swapped, kept), atol=1e-4)


def test_rows_of_a_batch_are_independent(mae, pictures, kept):
    assert torch.allclose(mae(pictures, kept)[1:], mae(pictures[1:], kept[1:]), atol=1e-5)


def test_frozen_weights_pass_gradients_to_the_visible_picture_alone(mae, pictures, kept):
    mae.requires_grad_(False)
    pictures.requires_grad_()
    mae(pictures, kept).square().sum().backward()
    of_patches = patchify(pictures.grad, 8).abs().sum(-1)
    assert (of_patches[kept] > 0).all() and (of_patches[~kept] == 0).all()
    assert all(parameter.grad is None for parameter in mae.parameters())


def test_refuses_uneven_masks_and_other_pictures(mae, pictures, kept):
    uneven = kept.clone()
    uneven[0] = True
    with pytest.raises(ShapeError, match="rows keep 5 to 16 patches"):
        mae(pictures, uneven)
    with pytest.raises(ShapeError, match=r"expected shape \[N 6 32 32\].*got \[2, 6, 64, 64\]"):
        mae(torch.zeros(2, 6, 64, 64), kept)


def test_file_round_trip_and_bad_files(mae, pictures, kept, tmp_path):
    path = tmp_path / "small.safetensors"
    save_file({name: value.contiguous() for name, value in mae.state_dict().items()}, path)
    described = {"config": {**SMALL.__dict__}}
    (tmp_path / "small.json").write_text(json.dumps(described))
    loaded = load_mae(path)
    assert torch.equal(loaded(pictures, kept), mae(pictures, kept))
    assert not any(parameter.requires_grad for parameter in loaded.parameters()) and not loaded.training

    (tmp_path / "small.json").write_text(json.dumps({"config": {**SMALL.__dict__, "width": 96}}))
    with pytest.raises(UserError, match="small.safetensors: does not fit its description"):
        load_mae(path)
    path.write_bytes(b"<html>not found</html>")
    with pytest.raises(UserError, match="small.safetensors: is a web page"):
        load_mae(path)
    with pytest.raises(UserError, match=r"absent.safetensors: no such file; give the .safetensors"):
        load_mae(tmp_path / "absent.safetensors")


def test_a_description_of_before_normalisation_is_read(mae, tmp_path):
    save_file({name: value.contiguous() for name, value in mae.state_dict().items()}, tmp_path / "old.safetensors")
    old = {name: value for name, value in SMALL.__dict__.items() if name != "normalisation"}
    (tmp_path / "old.json").write_text(json.dumps({"config": old}))
    assert load_mae(tmp_path / "old.safetensors").config == SMALL


def test_weights_that_are_not_finite_are_refused(mae, official, tmp_path):
    tensors = {name: value.contiguous() for name, value in mae.state_dict().items()}
    tensors["norm.bias"][3] = torch.nan
    save_file(tensors, tmp_path / "bad.safetensors")
    (tmp_path / "bad.json").write_text(json.dumps({"config": {**SMALL.__dict__}}))
    official["blocks.1.attn.qkv.bias"][0] = torch.inf
    torch.save({"model": official}, tmp_path / "bad.pth")
    for file, name in (("bad.safetensors", "norm.bias"), ("bad.pth", "blocks.1.attn.qkv.bias")):
        with pytest.raises(UserError, match=f"{file}: {name} holds values that are not finite"):
            load_mae(tmp_path / file)


# --- official checkpoints --------------------------------------------------------------------------------------------


def test_imagenet_networks_read_and_predict_in_its_colours(colours, kept):
    """As a plain network between the published normalisation and its inverse, channel by channel."""
    torch.manual_seed(0)
    scaled = MAE(replace(SMALL, channels=3, normalisation="imagenet")).eval()
    plain = MAE(replace(SMALL, channels=3)).eval()
    plain.load_state_dict(scaled.state_dict())
    mean = torch.tensor([0.485, 0.456, 0.406])[:, None, None]
    deviation = torch.tensor([0.229, 0.224, 0.225])[:, None, None]
    predicted = unpatchify(plain((colours - mean) / deviation, kept), 8, (32, 32)) * deviation + mean
    assert torch.allclose(unpatchify(scaled(colours, kept), 8, (32, 32)), predicted, atol=1e-6)
    assert predicted.abs().max() < 0.1  # a fresh network answers with the dark background


def test_normalisation_needs_three_channels():
    with pytest.raises(UserError, match="3 channels, not 6"):
        MAEConfig(normalisation="imagenet")
    with pytest.raises(UserError, match="unknown name 'photos'"):
        MAEConfig(channels=3, normalisation="photos")


@pytest.mark.parametrize("layout", ["model", "bare", "legacy", "resumable", "half"])
def test_official_layout(official, colours, kept, tmp_path, layout):
    path = tmp_path / "mae_visualize_vit_small.pth"
    content = {"model": official}
    if layout == "bare":
        content = official
    elif layout == "resumable":  # as the official training leaves it
        content |= {"epoch": 799, "args": argparse.Namespace(model="mae_vit", lr=None), "optimizer": {"state": {}}}
    elif layout == "half":
        content = {"model": {name: value.half() for name, value in official.items()}}
    torch.save(content, path, _use_new_zipfile_serialization=layout != "legacy")
    assert zipfile.is_zipfile(path) == (layout != "legacy")
    mae = load_mae(path)
    assert mae.config == MAEConfig(32, 8, 3, 64, 2, 1, 64, 1, 2, "imagenet")
    assert not mae.training and not any(parameter.requires_grad for parameter in mae.parameters())
    twin = MAE(mae.config).eval()
    twin.load_state_dict(official)
    assert torch.allclose(mae(colours, kept), twin(colours, kept), atol=2e-2 if layout == "half" else 1e-6)


def test_the_tables_of_positions_are_the_files_own(official, tmp_path):
    official["pos_embed"] = official["pos_embed"].flip(1)
    torch.save({"model": official}, tmp_path / "mae.pth")
    assert torch.equal(load_mae(tmp_path / "mae.pth").pos_embed, official["pos_embed"])


def test_networks_of_standardised_patches_are_named(official, tmp_path):
    torch.save({"model": official}, tmp_path / "mae_pretrain_vit_small_full.pth")
    with pytest.warns(UserWarning, match="standardised"):
        load_mae(tmp_path / "mae_pretrain_vit_small_full.pth")


class Harmful:
    def __reduce__(self):
        return print, ("run",)


def test_checkpoints_that_cannot_be_used_are_refused(official, tmp_path, capsys):
    def without(start):
        return {name: value for name, value in official.items() if not name.startswith(start)}

    grey = official | {"patch_embed.proj.weight": torch.zeros(64, 1, 8, 8)}
    narrow = official | {"norm.bias": torch.zeros(32)}
    for content, message in (
        ({"model": without(("decoder_", "mask_"))}, "encoder without its decoder.*mae_visualize_vit_large.pth"),
        ({"model": without("mask_token")}, "1 tensors are missing or unknown: mask_token;"),
        ({"model": official | {"head.weight": torch.zeros(2)}}, "unknown: head.weight"),
        ({"model": grey}, "pictures of 1 channels"),
        ({"model": narrow}, r"norm.bias has the shape \[32\], expected \[64\]"),
        ({"model": without("pos_embed")}, "not laid out as an official MAE .*pos_embed"),
        ({"model": {"weight": torch.zeros(2)}}, "not laid out as an official MAE"),
        ({"model": {"weights": "none"}}, "holds no network's tensors"),
        ([1, 2], "holds no network's tensors"),
        ({"model": official, "args": Harmful()}, "holds more than tensors and plain values"),
    ):
        torch.save(content, tmp_path / "bad.pth")
        with pytest.raises(UserError, match=f"bad.pth: .*{message}") as caught:
            load_mae(tmp_path / "bad.pth")
        assert "\n" not in str(caught.value)
    for content in (b"", b"<html>not found</html>", b"PK\x03\x04", b"nothing"):
        (tmp_path / "bad.pth").write_bytes(content)
        with pytest.raises(UserError, match="bad.pth: is (damaged|empty|a web page)"):
            load_mae(tmp_path / "bad.pth")
    with pytest.raises(UserError, match="absent.pth: no such file"):
        load_mae(tmp_path / "absent.pth")
    assert capsys.readouterr().out == ""


def test_files_beyond_any_network_are_not_read(tmp_path):
    with (tmp_path / "vast.pth").open("wb") as file:
        file.truncate(13 * 2**30)  # sparse
    with pytest.raises(UserError, match="has 13958643712 bytes, more than the 12884901888 that are read"):
        load_mae(tmp_path / "vast.pth")
