"""Where a dataset lies, as a command's argument: a folder's path, or a bucket's address."""

from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from twinlens.dataset import Place


class PlaceType(click.ParamType):  # type: ignore[type-arg]
    """A path, or an address such as s3://bucket/set; what is wrong with it is found when it is used."""

    name = "path or address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> "Place":
        """The Path or RemotePath."""
        from twinlens.dataset import place

        return place(value)


PLACE = PlaceType()
