"""The measured Cornell box, as Cornell University publishes it, and its spectra as linear Rec. 709.

Source: Cornell University Program of Computer Graphics, "Cornell Box Data",
https://www.graphics.cornell.edu/online/box/data.html: vertex coordinates in millimetres, reflectances at 4 nm from 400
to 700 nm, lamp spectrum at 100 nm. Colour matching: CIE 1931 2° observer and illuminant D65 (CIE 15), here at 10 nm.
"""

from __future__ import annotations

import numpy as np
from shapes import Array

WHITE = """343 445 551 624 665 687 708 723 715 710 745 758 739 767 777 765 751 745 748 729 745 757 753 750 746 747 735 732 739
734 725 721 733 725 732 743 744 748 728 716 733 726 713 740 754 764 752 736 734 741 740 732 745 755 751 744 731 733 744 731
712 708 729 730 727 707 703 729 750 760 751 739 724 730 740 737"""
GREEN = """92 96 98 97 98 95 95 97 95 94 97 98 96 101 103 104 107 109 112 115 125 140 160 187 229 285 343 390 435 464 472 476
481 462 447 441 426 406 373 347 337 314 285 277 266 250 230 207 186 171 160 148 141 136 130 126 123 121 122 119 114 115 117
117 118 120 122 128 132 139 144 146 150 152 157 159"""
RED = """40 46 48 53 49 50 53 55 57 56 59 57 61 61 60 62 62 62 61 62 60 59 57 58 58 58 56 55 56 59 57 55 59 59 58 59 61 61 63
63 67 68 72 80 90 99 124 154 192 255 287 349 402 443 487 513 558 584 620 606 609 651 612 610 650 638 627 620 630 628 642 639
657 639 635 642"""
LAMP = ((400.0, 500.0, 600.0, 700.0), (0.0, 8.0, 15.6, 18.4))
LAMP_REFLECTANCE = 0.78

# CIE 1931 x̄, ȳ, z̄ and D65, every 10 nm from 400 to 700 nm.
_OBSERVER = """.01431 .000396 .06785 82.7549 .04351 .00121 .2074 91.486 .13438 .004 .6456 93.4318 .2839 .0116 1.3856 86.6823
.34828 .023 1.74706 104.865 .3362 .038 1.77211 117.008 .2908 .06 1.6692 117.812 .19536 .09098 1.28764 114.861
.09564 .13902 .81295 115.923 .03201 .20802 .46518 108.811 .0049 .323 .272 109.354 .0093 .503 .1582 107.802
.06327 .71 .07825 104.79 .1655 .862 .04216 107.689 .2904 .954 .0203 104.405 .43345 .99495 .00875 104.046
.5945 .995 .0039 100 .7621 .952 .0021 96.3342 .9163 .87 .00165 95.788 1.0263 .757 .0011 88.6856
1.0622 .631 .0008 90.0062 1.0026 .503 .00034 89.5991 .85445 .381 .00019 87.6987 .6424 .265 .00005 83.2886
.4479 .175 .00002 83.6992 .2835 .107 0 80.0268 .1649 .061 0 80.2146 .0874 .032 0 82.2778
.04677 .017 0 78.2842 .0227 .00821 0 69.7213 .011359 .004102 0 71.6091"""
_NM = np.arange(400.0, 700.5, 4.0)
_RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.969266, 1.8760108, 0.041556], [0.0556434, -0.2040259, 1.0572252]]
)


def _observer() -> tuple[Array, Array]:
    """Colour matching functions (76, 3) and D65 (76,) at the wavelengths of the reflectances."""
    table = np.array(_OBSERVER.split(), dtype=np.float64).reshape(-1, 4)
    columns = [np.interp(_NM, np.arange(400.0, 705.0, 10.0), c) for c in table.T]
    return np.stack(columns[:3], axis=1), columns[3]


def albedo(spectrum: str) -> tuple[float, ...]:
    """Linear Rec. 709 albedo of a reflectance in thousandths: seen under D65, a perfect white being (1, 1, 1)."""
    cmf, d65 = _observer()
    reflectance = np.array(spectrum.split(), dtype=np.float64) / 1000.0
    seen = _RGB_FROM_XYZ @ (cmf.T @ (d65 * reflectance))
    return tuple(round(float(v), 4) for v in seen / (_RGB_FROM_XYZ @ (cmf.T @ d65)))


def lamp_radiance() -> tuple[float, ...]:
    """Linear Rec. 709 radiance of the lamp: a spectrum that is 1 at all wavelengths has luminance Y = 1."""
    cmf, _ = _observer()
    emitted = np.interp(_NM, *LAMP)
    return tuple(round(float(v), 4) for v in _RGB_FROM_XYZ @ (cmf.T @ emitted / cmf[:, 1].sum()))
