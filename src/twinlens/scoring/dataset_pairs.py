"""The pairs of a dataset on the disk: one for every sample and lens, each read only when its turn comes."""

from collections.abc import Iterator, Sequence
from typing import overload

from twinlens.dataset import StoredSample
from twinlens.scoring.pair import Pair, optional, search_range


def lens_label(lens: object) -> str:
    """A lens in a few words, told from what it has: an aperture, and a plane of focus.

    >>> from twinlens.camera import Pinhole, ThinLens
    >>> lens_label(Pinhole()), lens_label(ThinLens(0.02, 1.5))
    ('pinhole', 'lens 20 mm at 1.5 m')
    """
    diameter, focus = getattr(lens, "aperture_diameter", None), getattr(lens, "focus_distance", None)
    if not diameter:
        return "pinhole"
    return f"hole {1e3 * diameter:.3g} mm" if focus is None else f"lens {1e3 * diameter:.3g} mm at {focus:.3g} m"


class DatasetPairs(Sequence[Pair]):
    """What a benchmark runs over: every sample of a `Dataset` (or any sequence of stored samples), once for each lens.

    A sample with one lens keeps its name; one with several gives "name · lens", numbered where lenses read alike. Maps
    of these may also be called name/lens-0, name-lens-0 and so on; those of the first lens, whose images are the
    sample's own, plainly name. Indexing reads that pair from the disk; nothing is kept.
    """

    def __init__(self, samples: Sequence[StoredSample]) -> None:
        named = [(sample, k, name) for sample in samples for k, name in enumerate(_names(sample))]
        taken = {name for _, _, name in named}
        self._jobs = [(*job, tuple(a for a in _aliases(job[0], job[1]) if a not in taken)) for job in named]

    def __len__(self) -> int:
        return len(self._jobs)

    @overload
    def __getitem__(self, index: int) -> Pair: ...
    @overload
    def __getitem__(self, index: slice) -> list[Pair]: ...
    def __getitem__(self, index: int | slice) -> Pair | list[Pair]:
        if isinstance(index, slice):
            return [_pair(*job) for job in self._jobs[index]]
        return _pair(*self._jobs[index])

    def __iter__(self) -> Iterator[Pair]:
        return (_pair(*job) for job in self._jobs)

    @property
    def names(self) -> tuple[str, ...]:
        """The pairs' names, in order, without reading an image."""
        return tuple(name for _, _, name, _ in self._jobs)

    @property
    def aliases(self) -> dict[str, tuple[str, ...]]:
        """For every pair's name, what else a submission's map of it may be called, without the ending."""
        return {name: aliases for _, _, name, aliases in self._jobs}

    @property
    def map_names(self) -> dict[str, str]:
        """For every pair's name, the file that a submission's map of it is best called."""
        return {name: f"{aliases[0] if aliases else name}.pfm" for _, _, name, aliases in self._jobs}


def _names(sample: StoredSample) -> list[str]:
    if sample.num_lenses == 1:
        return [sample.name]
    labels = [lens_label(sample.lens(k).lens) for k in range(sample.num_lenses)]
    return [
        f"{sample.name} · {label}" + (f" ({k})" if labels.count(label) > 1 else "") for k, label in enumerate(labels)
    ]


def _aliases(sample: StoredSample, k: int) -> tuple[str, ...]:
    if sample.num_lenses == 1:
        return ()
    numbered = f"{sample.name}/lens-{k}", f"{sample.name}-lens-{k}"
    return numbered if k else (*numbered, sample.name)


def _pair(sample: StoredSample, k: int, name: str, aliases: tuple[str, ...]) -> Pair:
    shot, truth, calibration = sample.lens(k), sample.disp0, optional(lambda: sample.calibration)
    ndisp, first = search_range(sample.ndisp, calibration, truth)
    return Pair(
        name,
        shot.im0,
        shot.im1,
        truth,
        sample.mask0_nonocc,
        ndisp,
        calibration,
        optional(lambda: shot.blur_circle_px(0)),
        optional(lambda: sample.truth0.material_kind),
        first,
        aliases,
    )
