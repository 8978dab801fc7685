"""Pictures of the validation report, one module each; to add one, write `draw(folder) -> Figure` and a line here."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from tests.validation.case import Folder
from tests.validation.plots import (
    buoy,
    convergence,
    decay,
    flights,
    kernels,
    load_factor,
    modes,
    response,
    righting,
    ship,
    spectrum,
    trim,
    turbulence,
    turning,
    zigzag,
)


@dataclass(frozen=True)
class Picture:
    """A picture of the section about the tables in folder `section`."""

    section: str
    name: str
    draw: Callable[[Folder], Figure]
    caption: str


PICTURES = (
    Picture("waves", "spectrum", spectrum.draw,
            "Elevation records of 64 realisations at one point, by Welch's method, against the specified spectrum."),
    Picture("hydrostatics", "response", response.draw,
            "A box with constant added mass and damping (those of the boundary-element code at the resonances), "
            "released in small regular waves, until its motion is steady. Amplitudes follow the boundary-element code "
            "up to resonance; above it heave falls off too fast, the price of constant coefficients."),
    Picture("hydrostatics", "righting", righting.draw,
            "Left: the box against the wall-sided formula, which holds until an edge enters or leaves the water. "
            "Right: the shipped hulls."),
    Picture("hydrostatics", "remembered", response.remembered,
            "The same box, shipped as `barge`, with the radiation memory and the diffraction of its database. "
            "Amplitudes follow the boundary-element code on both sides of each resonance."),
    Picture("hydrostatics", "kernels", kernels.draw,
            "Damping by the boundary-element code and by the memory that stands for it in the equations of motion, and "
            "the kernel of heave. The Otter's sharp resonances of water between the pontoons are fitted least well."),
    Picture("hydrostatics", "convergence", convergence.draw,
            "Heave, roll and pitch from a quarter of the lowest resonance to 2.2 of the highest. Shipped databases "
            "have some 1,200 panels (the barge's own has the 720 even ones of the tables it is compared with)."),
    Picture("ships", "ship", ship.draw,
            "The shipped vehicle of the tables' name, or a hull made of their panels, with its database, released in "
            "small regular waves until its motion is steady."),
    Picture("buoys", "buoy", buoy.draw,
            "The hour with the highest waves. Directions by maximum entropy; the band shows one circular deviation to "
            "either side."),
    Picture("otter", "turning", turning.draw,
            "The linear model under held shaft speeds over the converged integration of the published equations."),
    Picture("otter", "decay", decay.draw,
            "The linear model has the published stiffness, in which heave drives pitch (G35 = 1508 N). The hull of "
            "panels has the stiffness of its shape, which hardly couples them: its heave and pitch ring longer."),
    Picture("otter", "zigzag", zigzag.draw,
            "The command changes sides when the heading passes 20 degrees: the differential thrust is the rudder. Our "
            "two models; there is no table."),
    Picture("aerosonde", "trim", trim.draw,
            "Trims of both variants of the published numbers over the airspeeds at which there is one: from the stall "
            "to full throttle or the aircraft's limit. Variant B flies in the scenarios."),
    Picture("aerosonde", "modes", modes.draw,
            "Eigenvalues of the linear models; conjugates are left out. The spiral grows, slowly, as published."),
    Picture("aerosonde", "doublets", flights.doublets,
            "A deflection of 0.05 rad one way from 1 to 1.5 s and the other way until 2 s, from the trim. Below each: "
            "this package less the reference, at its rows."),
    Picture("aerosonde", "phugoid", flights.phugoid,
            "Let go 2 m/s above the trim's airspeed: height and speed are exchanged, until the spiral takes over."),
    Picture("aerosonde", "load_factor", load_factor.draw,
            "V-n diagrams of the shipped aircraft, elevator at zero. Lines: the limits of `tools/aircraft.py`; "
            "circles: the most and the least lift that the loads of the stepping kernel reach."),
    Picture("dryden", "turbulence", turbulence.spectra,
            "Welch's method on records of the kernels' filters and random numbers, as an aircraft meets them, over the "
            "closed form."),
    Picture("dryden", "turbulence_variance", turbulence.variances,
            "Low wide gusts last long: a ten-minute record holds few of them, and bars say how few."),
)  # fmt: skip
