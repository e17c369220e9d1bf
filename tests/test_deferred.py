"""Deferred modules are what they would have been, only later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from pointsdf_cli.deferred import LEAVES, TORCH_LEAVES


def run(code: str, folder: Path) -> list[str]:
    code = f"import sys\nsys.path.insert(0, {str(folder)!r})\n" + code
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def make_package(folder: Path) -> None:
    package = folder / "whole"
    package.mkdir()
    (package / "__init__.py").write_text("from whole import leaf as leaf\n")
    (package / "leaf.py").write_text("print('leaf runs')\n__all__ = ['value']\nvalue = 7\n")


DEFER = (
    "from pointsdf_cli import deferred\n"
    "deferred.LEAVES = ('whole.leaf',)\n"
    "deferred.defer_unused()\n"
    "import whole\n"
    "print('imported')\n"
)


def test_a_deferred_module_runs_when_it_is_used_and_once(tmp_path: Path) -> None:
    make_package(tmp_path)
    told = run(DEFER + "print(whole.leaf.value, whole.leaf.value, type(whole.leaf))\n", tmp_path)
    assert told == ["imported", "leaf runs", "7 7 <class 'module'>"]


def test_names_are_imported_from_a_deferred_module(tmp_path: Path) -> None:
    make_package(tmp_path)
    told = run(DEFER + "from whole.leaf import *\nprint(value)\n", tmp_path)
    assert told == ["imported", "leaf runs", "7"]


def test_a_module_within_a_deferred_package_loads_after_it_and_once(tmp_path: Path) -> None:
    package = tmp_path / "whole"
    (package / "leaf").mkdir(parents=True)
    (package / "__init__.py").write_text("from whole import leaf as leaf\n")
    (package / "leaf" / "__init__.py").write_text(
        "print('leaf runs')\nfrom whole.leaf.inner import value\n"
    )
    (package / "leaf" / "inner.py").write_text("print('inner runs')\nvalue = 7\n")
    told = run(
        DEFER + "import whole.leaf.inner as inner\n"
        "print(inner.value, inner is whole.leaf.inner, inner.__spec__.has_location)\n",
        tmp_path,
    )
    assert told == ["imported", "leaf runs", "inner runs", "7 True True"]


def test_a_name_that_a_deferred_module_lacks_is_an_attribute_error(tmp_path: Path) -> None:
    make_package(tmp_path)
    told = run(DEFER + "print(hasattr(whole.leaf, 'other'))\n", tmp_path)
    assert told == ["imported", "leaf runs", "False"]


def test_an_attribute_that_is_lacking_keeps_nothing_of_the_caller(tmp_path: Path) -> None:
    make_package(tmp_path)
    told = run(
        "import gc, weakref\ngc.disable()\n" + DEFER + "class Held: pass\n"
        "def ask():\n"
        "    held = Held()\n"
        "    try:\n"
        "        whole.leaf.__path__\n"
        "    except AttributeError:\n"
        "        return weakref.ref(held)\n"
        "print(ask()())\n",
        tmp_path,
    )
    assert told == ["imported", "None"]


def test_libraries_load_without_what_is_deferred_and_have_it_when_asked(tmp_path: Path) -> None:
    told = run(
        "from pointsdf_cli.deferred import defer_unused\n"
        "defer_unused()\n"
        "import scipy.spatial, torch\n"
        f"names = {[*LEAVES, *TORCH_LEAVES]!r}\n"
        "loaded = [name for name in names if type(sys.modules.get(name)).__name__ == 'module']\n"
        "print(*loaded)\n"
        "import numpy as np\n"
        "print(np.ma.masked_less(np.arange(3), 1).sum(), np.polynomial.Polynomial([1, 2])(3))\n"
        "print(float(torch.distributions.Normal(0.0, 1.0).cdf(torch.zeros(()))))\n"
        "print(len(torch.utils.data.TensorDataset(torch.zeros(4))), torch.export.export.__name__)\n"
        "print(tuple(torch.zeros(2, 3, device='meta').exp().shape))\n",
        tmp_path,
    )
    whole = [] if told[0] == "" else told[0].split()
    assert set(whole) <= set(TORCH_LEAVES)  # another version of torch loads whole
    assert told[1:] == ["3 7.0", "0.5", "4 export", "(2, 3)"]


def test_what_optimisers_load_finds_all_of_torch(tmp_path: Path) -> None:
    told = run(
        "from pointsdf_cli.deferred import defer_unused\n"
        "defer_unused()\n"
        "import torch\n"
        "weight = torch.nn.Parameter(torch.ones(1))\n"
        "step = torch.optim.AdamW([weight], lr=0.5, weight_decay=0.0)\n"
        "weight.sum().backward()\n"
        "step.step()\n"
        "print(round(weight.item(), 3))\n",
        tmp_path,
    )
    assert told == ["0.5"]


def test_meshes_load_without_networkx_and_have_it_when_asked(tmp_path: Path) -> None:
    told = run(
        "from pointsdf_cli.deferred import defer_unused\n"
        "defer_unused()\n"
        "import trimesh\n"
        "box = trimesh.creation.box((1, 1, 1))\n"
        "print('networkx.algorithms' in sys.modules, box.is_watertight)\n"
        "print(len(box.vertex_adjacency_graph), type(sys.modules['networkx']).__name__)\n",
        tmp_path,
    )
    assert told == ["False True", "8 module"]


def test_scipy_loads_without_parsing_its_docstrings(tmp_path: Path) -> None:
    told = run(
        "from pointsdf_cli.deferred import defer_unused\n"
        "defer_unused()\n"
        "import numpy as np, scipy.cluster.vq, scipy.ndimage, scipy.spatial\n"
        "from scipy._lib import _array_api\n"
        "print(getattr(_array_api, 'FunctionDoc', None))\n"
        "turn = scipy.spatial.transform.Rotation.from_rotvec([0, 0, np.pi / 2])\n"
        "print(np.round(turn.apply([1, 0, 0]), 6).tolist())\n"
        "print(scipy.spatial.ConvexHull(np.eye(4)[:, :3]).volume)\n",
        tmp_path,
    )
    # Old versions have no such parser.
    assert told[0] in ("<class 'pointsdf_cli.deferred._NoDocstring'>", "None")
    assert told[1] == "[0.0, 1.0, 0.0]"
    assert abs(float(told[2]) - 1 / 6) < 1e-12


def test_what_needs_deferred_parts_of_numpy_loads(tmp_path: Path) -> None:
    told = run(
        "from pointsdf_cli.deferred import defer_unused\n"
        "defer_unused()\n"
        "import scipy.signal\n"
        "print(scipy.signal.windows.boxcar(2).tolist())\n",
        tmp_path,
    )
    assert told == ["[1.0, 1.0]"]
