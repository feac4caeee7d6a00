# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One description for pip (`.venv/bin/hyst` and the nodes) and for colcon (`ros2 run hyst_control <node>`)."""

import re
import runpy
from pathlib import Path

from setuptools import find_packages, setup

NAME = "hyst_control"
root = Path(__file__).parent
VERSION = re.findall("<version>(.*)</version>", (root / "package.xml").read_text(encoding="utf-8"))[0]  # where bloom writes it
NODES = runpy.run_path(str(root / "hyst_control" / "processes" / "node_list.py"))["NODES"]
INSTALLED = ("config", "docs", "launch")
folders = [
    path.relative_to(root)
    for name in INSTALLED
    for path in sorted([root / name, *(root / name).rglob("*")])
    if path.is_dir() and path.name != "__pycache__"
]
# Without versions: a ROS 2 machine has its distribution's. What `make` and the checks install is pinned in requirements.txt.
REQUIRED = [
    "numpy",
    "scipy!=1.15.0,!=1.15.1,!=1.15.2",  # their running median is wrong
    "numba",
    "PyYAML",
    "matplotlib",
    "plotly",
    "tqdm",
    "jinja2",
    "platformdirs",
    "mcap",
    "lz4",
    "zstandard",
    "argcomplete",
    "cffi",
]

setup(
    name=NAME,
    version=VERSION,
    description="Identification, control and gap diagnosis of piezo stages and fast steering mirrors with hysteresis",
    license="Apache-2.0",
    python_requires=">=3.10",
    install_requires=REQUIRED,
    extras_require={
        "dashboard": ["bokeh", "tornado"],
        "fleet": ["distributed", "bokeh", "pyarrow"],
        "bags": ["rosbags"],
        "frames": ["pandas", "xarray"],
        "parquet": ["pyarrow"],
        "tables": ["pyarrow", "openpyxl", "h5py", "npTDMS"],
        "pi": ["pipython"],
        "epics": ["caproto"],
        "bluesky": ["bluesky"],
        "foxglove": ["foxglove-sdk"],
        "mujoco": ["mujoco"],
        "test": ["pytest", "pytest-timeout", "hypothesis", "rosbags"],  # by which colcon test knows that pytest runs them
    },
    packages=find_packages(include=["hyst_control*", "hyst_plant_sim*"]),
    package_data={
        "hyst_control": ["*/*.yaml", "*/*/*.yaml", "*/templates/*", "*/templates/*/*", "*/*.c.in", "*/*/*.c.in", "py.typed"],
        "hyst_plant_sim": ["py.typed"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "README.md", "CHANGELOG.rst", "LICENSE"]),
        *(
            (
                f"share/{NAME}/{folder}",
                [str(file.relative_to(root)) for file in sorted((root / folder).iterdir()) if file.is_file()],
            )
            for folder in folders
        ),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "hyst = hyst_control.processes.executables:hyst",
            *(f"{name} = hyst_control.processes.executables:{name}" for name, node in NODES.items() if node.installed),
        ]
    },
)
