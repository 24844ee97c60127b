"""The layers go one way, facades are empty, and nothing heavy is imported before it is used."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("mitsuba", "drjit", "timm", "smplx", "cv2", "av", "kornia")
LAYERS = ("renderers", "refine", "train", "refine.cli")
OWNERS = {
    "mitsuba": {"renderers.mitsuba_scene"},
    "timm": {"refine.mae"},
}


def layer(module: str) -> int:
    return LAYERS.index("refine.cli" if module.startswith("refine.cli") else module.partition(".")[0])


@cache
def modules() -> dict[str, Path]:
    """Every module of the three packages by its dotted name."""
    found = {}
    for package in ("renderers", "refine", "train"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports(module: str, inside_functions: bool) -> set[str]:
    """Dotted names that a module imports; those of ``if TYPE_CHECKING`` are for readers only and left out."""
    nodes, found = list(ast.parse(modules()[module].read_text()).body), set()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            found |= {f"{node.module}.{name.name}" if is_module(node, name) else node.module for name in node.names}
        if inside_functions or not isinstance(node, ast.FunctionDef):
            nodes += [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
    return found


def is_module(node: ast.ImportFrom, name: ast.alias) -> bool:
    return f"{node.module}.{name.name}" in modules()


def test_the_reader_of_imports_reads():
    assert "renderers.checks" in imports("renderers.camera", inside_functions=False)
    assert "renderers.raster_fold" in imports("renderers.silhouette", inside_functions=False)
    assert "av" in imports("renderers.images", inside_functions=True) - imports("renderers.images", False)


@pytest.mark.parametrize("module", modules())
def test_layers_go_one_way(module):
    ours = {name for name in imports(module, inside_functions=True) if name.partition(".")[0] in LAYERS}
    upwards = {name for name in ours if layer(name) > layer(module)}
    assert not upwards, f"{module} imports from a layer above: {upwards}"
    facades = ours & {"renderers", "refine", "train", "refine.formats", "refine.cli", "refine.procedural"}
    assert not facades, f"{module} imports a package instead of the file that defines the name"


def test_there_is_no_cycle():
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]):
        assert module not in path, " -> ".join((*path[path.index(module) :], module))
        if module not in done:
            for name in imports(module, inside_functions=True) & set(modules()):
                visit(name, (*path, module))
            done.add(module)

    for module in modules():
        visit(module, ())


def test_facades_are_empty():
    facades = {module: path for module, path in modules().items() if path.name == "__init__.py"}
    assert len(facades) >= 5
    for module, path in facades.items():
        assert not ast.parse(path.read_text()).body[1:], f"{module} does more than say what it is"
        assert not imports(module, inside_functions=True), f"{module} imports"


@pytest.mark.parametrize("library", OWNERS)
def test_one_module_owns_a_heavy_library(library):
    users = {m for m in modules() if any(n.partition(".")[0] == library for n in imports(m, inside_functions=True))}
    assert users <= OWNERS[library]


def loaded_after(code: str) -> set[str]:
    """Top-level names in sys.modules after running ``code`` in a fresh interpreter."""
    code += "\nimport sys; print('LOADED', *{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("LOADED")[2].split())


def test_importing_the_values_is_light():
    loaded = loaded_after("import refine, refine.motion, refine.energies, renderers.images, renderers.silhouette")
    assert "torch" in loaded
    assert not loaded & set(HEAVY)


@pytest.mark.parametrize("arguments", [["--help"], ["compose", "--help"], ["generate", "--help"]])
def test_help_does_not_even_load_torch(arguments):
    code = f"""
from refine.cli.main import main
try:
    main({arguments!r})
except SystemExit as stopped:
    assert stopped.code == 0
"""
    assert not loaded_after(code) & {"torch", *HEAVY}
