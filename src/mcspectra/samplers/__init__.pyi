from .base import Randomization as Randomization
from .base import Randomized as Randomized
from .base import Sampler as Sampler
from .dither import LowDiscrepancyBlueNoise as LowDiscrepancyBlueNoise
from .dither import VoidAndCluster as VoidAndCluster
from .engines import QmcpySampler as QmcpySampler
from .engines import ScipySampler as ScipySampler
from .external import CommandSampler as CommandSampler
from .external import FunctionSampler as FunctionSampler
from .external import GivenPoints as GivenPoints
from .external import PythonSampler as PythonSampler
from .external import allow_code as allow_code
from .hyperuniform import Determinantal as Determinantal
from .hyperuniform import PerturbedLattice as PerturbedLattice
from .hyperuniform import StealthyHyperuniform as StealthyHyperuniform
from .lattice import Fibonacci as Fibonacci
from .lattice import Korobov as Korobov
from .lattice import Kronecker as Kronecker
from .lattice import Rank1Lattice as Rank1Lattice
from .nets import DigitalNet as DigitalNet
from .nets import Faure as Faure
from .nets import LarcherPillichshammer as LarcherPillichshammer
from .nets import Niederreiter as Niederreiter
from .nets import Sobol as Sobol
from .orthogonal import LatinHypercube as LatinHypercube
from .orthogonal import NRooks as NRooks
from .orthogonal import OrthogonalArray as OrthogonalArray
from .poisson import BestCandidate as BestCandidate
from .poisson import DartThrowing as DartThrowing
from .poisson import PoissonDisk as PoissonDisk
from .progressive import PMJ as PMJ
from .progressive import PMJ02 as PMJ02
from .progressive import PMJ02BlueNoise as PMJ02BlueNoise
from .projective import ProjectiveBlueNoise as ProjectiveBlueNoise
from .radical import Halton as Halton
from .radical import Hammersley as Hammersley
from .radical import VanDerCorput as VanDerCorput
from .randomizations import Decorrelate as Decorrelate
from .randomizations import Mirror as Mirror
from .randomizations import RandomRotation as RandomRotation
from .randomizations import Shift as Shift
from .randomizations import StrataShift as StrataShift
from .registry import RANDOMIZATIONS as RANDOMIZATIONS
from .registry import SAMPLERS as SAMPLERS
from .registry import as_sampler as as_sampler
from .registry import sampler as sampler
from .relaxation import Bnot as Bnot
from .relaxation import FarthestPoint as FarthestPoint
from .relaxation import GaussianBlueNoise as GaussianBlueNoise
from .relaxation import Lloyd as Lloyd
from .relaxation import transport_cost as transport_cost
from .scrambles import DigitalShift as DigitalShift
from .scrambles import Lms as Lms
from .scrambles import Owen as Owen
from .scrambles import Permute as Permute
from .selection import Shuffle as Shuffle
from .selection import Skip as Skip
from .selection import Subset as Subset
from .sliced import SlicedOptimalTransport as SlicedOptimalTransport
from .spectral_targets import StepBlueNoise as StepBlueNoise
from .spectral_targets import TargetPcf as TargetPcf
from .spectral_targets import TargetSpectrum as TargetSpectrum
from .stratified import AntitheticJittered as AntitheticJittered
from .stratified import BoxJitter as BoxJitter
from .stratified import CorrelatedMultiJittered as CorrelatedMultiJittered
from .stratified import GaussianJitter as GaussianJitter
from .stratified import Hexagonal as Hexagonal
from .stratified import Jittered as Jittered
from .stratified import MultiJittered as MultiJittered
from .stratified import Random as Random
from .stratified import Regular as Regular
from .stratified import SharedCells as SharedCells
from .stratified import UniformJitter as UniformJitter

__all__ = [
    "PMJ",
    "PMJ02",
    "RANDOMIZATIONS",
    "SAMPLERS",
    "AntitheticJittered",
    "BestCandidate",
    "Bnot",
    "BoxJitter",
    "CommandSampler",
    "CorrelatedMultiJittered",
    "DartThrowing",
    "Decorrelate",
    "Determinantal",
    "DigitalNet",
    "DigitalShift",
    "FarthestPoint",
    "Faure",
    "Fibonacci",
    "FunctionSampler",
    "GaussianBlueNoise",
    "GaussianJitter",
    "GivenPoints",
    "Halton",
    "Hammersley",
    "Hexagonal",
    "Jittered",
    "Korobov",
    "Kronecker",
    "LarcherPillichshammer",
    "LatinHypercube",
    "Lloyd",
    "Lms",
    "LowDiscrepancyBlueNoise",
    "Mirror",
    "MultiJittered",
    "NRooks",
    "Niederreiter",
    "OrthogonalArray",
    "Owen",
    "PMJ02BlueNoise",
    "Permute",
    "PerturbedLattice",
    "PoissonDisk",
    "ProjectiveBlueNoise",
    "PythonSampler",
    "QmcpySampler",
    "Random",
    "RandomRotation",
    "Randomization",
    "Randomized",
    "Rank1Lattice",
    "Regular",
    "Sampler",
    "ScipySampler",
    "SharedCells",
    "Shift",
    "Shuffle",
    "Skip",
    "SlicedOptimalTransport",
    "Sobol",
    "StealthyHyperuniform",
    "StepBlueNoise",
    "StrataShift",
    "Subset",
    "TargetPcf",
    "TargetSpectrum",
    "UniformJitter",
    "VanDerCorput",
    "VoidAndCluster",
    "allow_code",
    "as_sampler",
    "sampler",
    "transport_cost",
]
