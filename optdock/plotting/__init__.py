"""Pictures of plans, motions and runs, which require the extra `plot`.

Every function draws completed results into one file.
"""

from optdock.plotting.animation import save_animation
from optdock.plotting.plan_picture import PlanDrawing, plan_picture_png, save_plan_picture, show_plan_picture
from optdock.plotting.profile_picture import save_profile_picture
from optdock.plotting.run_picture import save_docking_picture, save_run_picture

__all__ = [
    "PlanDrawing",
    "plan_picture_png",
    "save_animation",
    "save_docking_picture",
    "save_plan_picture",
    "save_profile_picture",
    "save_run_picture",
    "show_plan_picture",
]
