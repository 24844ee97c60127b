import math

import numpy as np
import pytest
import torch
from PIL import Image

from renderers import images, palette
from renderers.checks import ShapeError, UserError


def read(path) -> torch.Tensor:
    return torch.from_numpy(np.array(Image.open(path).convert("RGB"))).permute(2, 0, 1) / 255


def colour(name: str) -> torch.Tensor:
    return torch.tensor(palette.rgb(name))


def test_png_keeps_every_level_and_clamps(tmp_path):
    picture = torch.linspace(-0.5, 1.5, 3 * 5 * 7).reshape(3, 5, 7)
    images.save_png(tmp_path / "new" / "a.png", picture)
    found = read(tmp_path / "new" / "a.png")
    assert (found - picture.clamp(0, 1)).abs().max() <= 0.5 / 255 + 1e-6
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.png"]


def test_grey_pictures_are_drawn_grey(tmp_path):
    images.save_png(tmp_path / "a.png", torch.tensor([[0.0, 1.0]]))
    assert torch.equal(read(tmp_path / "a.png"), torch.tensor([[0.0, 1.0]]).expand(3, 1, 2))


def test_two_channels_are_no_picture(tmp_path):
    with pytest.raises(ShapeError, match=r"expected shape \[3 H W\].*got \[2, 4, 4\]"):
        images.save_png(tmp_path / "a.png", torch.zeros(2, 4, 4))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [(32, 48), (33, 47)])
def test_mp4_is_h264_with_every_frame_in_order(tmp_path, size):
    import av

    levels = [0.1, 0.5, 0.9, 0.3, 0.7]
    images.save_mp4(tmp_path / "a.mp4", [torch.full((3, *size), level) for level in levels], fps=12.5)
    with av.open(str(tmp_path / "a.mp4")) as movie:
        stream = movie.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in movie.decode(stream)]
        assert (stream.codec_context.name, stream.pix_fmt, float(stream.average_rate)) == ("h264", "yuv420p", 12.5)
    assert [frame.shape for frame in frames] == [(size[0] + size[0] % 2, size[1] + size[1] % 2, 3)] * 5
    assert [frame.mean() / 255 for frame in frames] == pytest.approx(levels, abs=0.02)


def test_gif_loops_at_its_rate(tmp_path):
    images.save_gif(tmp_path / "a.gif", torch.rand(4, 3, 8, 8), fps=10)
    with Image.open(tmp_path / "a.gif") as movie:
        assert (movie.n_frames, movie.info["duration"], movie.info["loop"]) == (4, 100, 0)


@pytest.mark.parametrize("save", [images.save_gif, images.save_mp4])
def test_no_frames_are_refused(tmp_path, save):
    with pytest.raises(UserError, match="there are no frames"):
        save(tmp_path / "a", [], 10)


def test_a_failed_film_leaves_the_old_one(tmp_path):
    (tmp_path / "a.mp4").write_text("old")
    with pytest.raises(ValueError):
        images.save_mp4(tmp_path / "a.mp4", [torch.zeros(3, 8, 8), torch.zeros(3, 16, 16)], 10)
    assert (tmp_path / "a.mp4").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_contact_sheet_sets_pictures_in_their_cells():
    red, blue = colour("#ff0000")[:, None, None], colour("#0000ff")[:, None, None]
    sheet = images.contact_sheet([[red.expand(3, 20, 30), blue.expand(3, 20, 30)], [blue.expand(3, 10, 30)]], gap=4)
    assert sheet.shape == (3, 4 + 20 + 4 + 10 + 4, 4 + 30 + 4 + 30 + 4)
    assert torch.equal(sheet[:, 4:24, 4:34], red.expand(3, 20, 30))
    assert torch.equal(sheet[:, 4:24, 38:68], blue.expand(3, 20, 30))
    assert torch.equal(sheet[:, 28:38, 4:34], blue.expand(3, 10, 30))
    assert torch.allclose(
        sheet[:, 28:38, 38:68], colour(palette.BACKGROUND)[:, None, None].expand(3, 10, 30), atol=3e-3
    )


def test_contact_sheet_writes_its_captions():
    cell = colour(palette.BACKGROUND)[:, None, None].expand(3, 40, 60)
    bare, written = (images.contact_sheet([[cell]], row_captions=[text]) for text in ("", "walking"))
    assert (bare - written).abs().max() > 0.5
    assert torch.equal(bare[:, -44:-4], written[:, -44:-4])


def test_parts_have_their_colours_and_mix_where_they_overlap():
    parts = torch.zeros(6, 1, 4)
    parts[2, 0, 0] = parts[5, 0, 1] = parts[2, 0, 2] = parts[5, 0, 2] = 1
    picture = images.part_picture(parts)
    left, right = colour(palette.PARTS[2]), colour(palette.PARTS[5])
    expected = torch.stack([left, right, (left + right) / 2, colour(palette.BACKGROUND)], dim=1)
    assert torch.allclose(picture[:, 0], expected, atol=1e-6)


def test_joints_are_larger_and_warmer_with_energy_and_stand_at_x_y():
    white = torch.ones(3, 100, 200)
    joints = torch.tensor([[30.5, 20.5], [150.5, 70.5]])
    picture = images.with_joints(white, joints, torch.tensor([0.0, 4.0]))
    changed = (picture - white).abs().amax(0) > 0.05
    weak, strong = changed[:, :90].sum(), changed[:, 90:].sum()
    assert 0 < weak < strong
    rows, columns = changed[:, 90:].nonzero().double().mean(0) + torch.tensor([0.5, 90.5])
    assert (float(columns), float(rows)) == pytest.approx((150.5, 70.5), abs=1)
    assert torch.allclose(picture[:, 70, 150], colour(palette.HEAT[-1]), atol=0.02)


def test_heat_runs_through_its_stops():
    found = images.heat(torch.tensor([0.0, 0.25, 0.5, 1.0, 7.0]))
    expected = torch.stack([colour(palette.HEAT[k]) for k in (0, 1, 2, 4, 4)])
    assert torch.allclose(found, expected, atol=1e-6)


def test_heat_map_scales_by_the_greatest_value_and_stretches():
    field = torch.tensor([[0.0, 2.0]])
    laid = images.heat_map(torch.zeros(3, 4, 8), field, opacity=1.0)
    assert torch.allclose(laid[:, :, :4], colour(palette.HEAT[0])[:, None, None].expand(3, 4, 4), atol=1e-6)
    assert torch.allclose(laid[:, :, 4:], colour(palette.HEAT[-1])[:, None, None].expand(3, 4, 4), atol=1e-6)


def test_only_dropped_patches_are_hidden():
    picture = torch.full((3, 20, 20), 0.2)
    shown = images.kept_patches(picture, torch.tensor([[True, False], [False, True]]))
    assert torch.equal(shown[:, :10, :10], picture[:, :10, :10])
    assert torch.equal(shown[:, 11:, 11:], picture[:, 11:, 11:])
    assert shown[:, :9, 11:].min() > 0.7
    assert shown[:, 11:, :9].min() > 0.7


def test_differences_are_red_where_the_first_has_more():
    first, second = torch.zeros(2, 1, 3), torch.zeros(2, 1, 3)
    first[1, 0, 0] = 1
    second[0, 0, 1] = 1
    expected = torch.tensor([[1.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    assert torch.allclose(images.difference_picture(first, second)[:, 0], expected)


def line_at(picture: torch.Tensor, name: str) -> torch.Tensor:
    """[K 2] (row, column) of pixels of a line's colour, below the legend."""
    near = (picture - colour(name)[:, None, None]).abs().amax(0) < 0.25
    near[:45] = False
    return near.nonzero()


def test_chart_puts_a_decade_at_equal_heights():
    picture = images.chart({"loss": [100.0] * 20 + [10.0] * 20 + [1.0] * 20}, "a loss")
    at = line_at(picture, palette.LINES[0]).double()
    across = (at[:, 1] - at[:, 1].min()) / (at[:, 1].max() - at[:, 1].min())
    levels = [at[(across - share).abs() < 0.1][:, 0].median() for share in (0.15, 0.5, 0.85)]
    assert float(levels[1] - levels[0]) == pytest.approx(float(levels[2] - levels[1]), abs=1.5)
    assert levels[1] - levels[0] > 50


def test_chart_leaves_gaps_for_what_has_no_logarithm():
    values = [1.0, 2.0] * 10 + [math.nan, 0.0, -1.0, math.inf] * 5 + [1.0, 2.0] * 10
    columns = line_at(images.chart({"a": values}, "gap"), palette.LINES[0])[:, 1].unique()
    share = (columns - columns.min()) / (columns.max() - columns.min())
    assert not ((share > 0.38) & (share < 0.62)).any()
    assert (share < 0.3).any()


def test_rounding_errors_do_not_stretch_the_axis():
    rows = [
        line_at(images.chart({"a": [first, *[1.0, 0.1] * 9]}, "steep"), palette.LINES[0])[:, 0] for first in (1e-15, 0)
    ]
    assert torch.equal(*rows)


@pytest.mark.parametrize("values", [[], [math.nan], [-1.0, 0.0]])
def test_chart_of_nothing_says_so(values):
    assert images.chart({"a": values}, "empty").shape == (3, 360, 640)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0, 10, [0, 2, 4, 6, 8, 10]), (0.01, 0.05, [0.01, 0.02, 0.03, 0.04, 0.05]), (-3, 4, [-4, -2, 0, 2, 4])],
)
def test_ticks_are_round_and_cover(low, high, expected):
    assert images._ticks(low, high) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("low", "high", "expected"), [(0.3, 4, [0.2, 0.5, 1, 2, 5]), (1e-4, 1, [1e-4, 1e-3, 1e-2, 0.1, 1])]
)
def test_log_ticks_are_decades_or_one_two_five(low, high, expected):
    assert images._log_ticks(low, high) == pytest.approx(expected)
