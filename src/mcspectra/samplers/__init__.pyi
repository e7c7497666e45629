from .base import Randomization as Randomization
from .base import Randomized as Randomized
from .base import Sampler as Sampler
from .base import Structure as Structure
from .digital import Sobol as Sobol
from .dither import VoidAndCluster as VoidAndCluster
from .external import FunctionSampler as FunctionSampler
from .external import GivenPoints as GivenPoints
from .external import ScipySampler as ScipySampler
from .kronecker import Kronecker as Kronecker
from .gaussian_blue_noise import GaussianBlueNoise as GaussianBlueNoise
from .lattice import Fibonacci as Fibonacci
from .lattice import Korobov as Korobov
from .lattice import Rank1Lattice as Rank1Lattice
from .poisson import PoissonDisk as PoissonDisk
from .radical import Halton as Halton
from .radical import Hammersley as Hammersley
from .radical import VanDerCorput as VanDerCorput
from .randomizations import DigitalShift as DigitalShift
from .randomizations import Owen as Owen
from .randomizations import Shift as Shift
from .randomizations import StrataShift as StrataShift
from .registry import RANDOMIZATIONS as RANDOMIZATIONS
from .registry import SAMPLERS as SAMPLERS
from .registry import as_sampler as as_sampler
from .registry import sampler as sampler
from .registry import sampler_from_calls as sampler_from_calls
from .stratified import Jittered as Jittered
from .stratified import LatinHypercube as LatinHypercube
from .stratified import MultiJittered as MultiJittered
from .stratified import Random as Random
from .stratified import Regular as Regular
from .stratified import UniformJitter as UniformJitter

__all__ = [
    "RANDOMIZATIONS",
    "SAMPLERS",
    "DigitalShift",
    "Fibonacci",
    "FunctionSampler",
    "GaussianBlueNoise",
    "GivenPoints",
    "Halton",
    "Hammersley",
    "Jittered",
    "Korobov",
    "Kronecker",
    "LatinHypercube",
    "MultiJittered",
    "Owen",
    "PoissonDisk",
    "Random",
    "Randomization",
    "Randomized",
    "Rank1Lattice",
    "Regular",
    "Sampler",
    "ScipySampler",
    "Shift",
    "Sobol",
    "StrataShift",
    "Structure",
    "UniformJitter",
    "VanDerCorput",
    "VoidAndCluster",
    "as_sampler",
    "sampler",
    "sampler_from_calls",
]
