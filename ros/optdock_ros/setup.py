"""The ament_python package; colcon needs this file."""

from pathlib import Path

from setuptools import setup

NAME = "optdock_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    package_data={NAME: ["*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{folder}", [str(path) for path in Path(folder).glob("*.*")])
            for folder in ("behavior_trees", "config", "examples", "launch", "rviz")
        ),
    ],
    install_requires=["setuptools", "optdock"],
    zip_safe=False,
    maintainer="The optdock developers",
    maintainer_email="optdock@example.org",
    description="Nav2's smoother and docking servers with optdock inside",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "smoother_server = optdock_ros.smoother_server:main",
            "docking_server = optdock_ros.docking_server:main",
            "simulated_robot = optdock_ros.simulated_robot:main",
        ]
    },
)
