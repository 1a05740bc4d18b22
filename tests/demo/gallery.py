# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the small pictures of docs/user/gallery.md from the output of `make demo` in build."""

from pathlib import Path

import bpy

ROOT = Path(__file__).parents[2]
QUALITY = 95  # percent


def main():
    target = ROOT / "docs" / "user" / "gallery"
    target.mkdir(exist_ok=True)
    settings = bpy.context.scene.render.image_settings
    settings.media_type, settings.file_format = "IMAGE", "WEBP"
    settings.quality = QUALITY
    bpy.context.scene.view_settings.view_transform = "Raw"  # already applied
    for source in sorted((ROOT / "build" / "demo").glob("*.png")):
        image = bpy.data.images.load(str(source))
        image.colorspace_settings.name = "Non-Color"
        image.save_render(str(target / source.with_suffix(".webp").name))


if __name__ == "__main__":
    main()
