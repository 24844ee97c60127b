"""The inpainter: geometry of its tokens, what may and may not influence it, its files (protocol E, G.13)."""

import json

import pytest
import torch
from safetensors.torch import save_file

from refine.mae import MAE, MAEConfig, load_mae, sincos_positions
from refine.patches import keep_random, patchify
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


def test_positions():
    table = sincos_positions(192, (14, 14))[0]
    assert table.shape == (197, 192) and not table[0].any()
    assert table[2, 0] == pytest.approx(0.841471) and table[2, 96] == 0
    assert table[15, 0] == 0 and table[15, 96] == pytest.approx(0.841471)


def test_size_of_the_published_small_network():
    tensors = MAE(MAEConfig(channels=3)).state_dict()
    assert sum(value.numel() for value in tensors.values()) == 3_174_016


def test_size_of_the_official_vit_l():
    with torch.device("meta"):
        tensors = MAE(
            MAEConfig(224, 16, 3, 1024, 24, 16, decoder_width=512, decoder_depth=8, decoder_heads=16)
        ).state_dict()
    assert len(tensors) == 398 and sum(value.numel() for value in tensors.values()) == 329_541_888


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
    with pytest.raises(UserError, match="small.safetensors: not the weights"):
        load_mae(path)
    path.write_bytes(b"<html>not found</html>")
    with pytest.raises(UserError, match="not the weights"):
        load_mae(path)
    with pytest.raises(UserError, match=r"absent.safetensors: no such file; give the .safetensors"):
        load_mae(tmp_path / "absent.safetensors")
