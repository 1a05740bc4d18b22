# SPDX-License-Identifier: GPL-3.0-or-later
"""What in a Blender file is ours, and what of the user's we changed and must give back."""

TAG = "lb_lighting_made"
KEPT = "lb_lighting_kept"


def is_ours(block):
    """True if `block` (a datablock or a node) was made by us."""
    return TAG in block


def find_ours(blocks, tag):
    """The local datablock of `blocks` that carries `tag`, or None."""
    return next((b for b in blocks if b.get(TAG) == tag and b.library is None), None)


def override(block, path, value):
    """Set the property at the RNA `path` of `block` and keep the user's value for `give_back`."""
    kept = block[KEPT].to_dict() if KEPT in block else {}
    # A second bake must not take our value for the user's.
    kept.setdefault(path, block.path_resolve(path))
    block[KEPT] = kept
    _set(block, path, value)


def is_overridden(block, path):
    """True while `override` holds the property at the RNA `path` of `block`."""
    return KEPT in block and path in block[KEPT]


def give_back(block):
    """Set every property that `override` changed back to the user's value, once."""
    if KEPT not in block:
        return
    for path, value in block[KEPT].to_dict().items():
        _set(block, path, value)
    del block[KEPT]


def _set(block, path, value):
    owner, _, name = path.rpartition(".")
    setattr(block.path_resolve(owner) if owner else block, name, value)
