"""Parameters that a sampler or randomization refuses, and the names in the error message.

The checks themselves (fractions, NaN, text for numbers) are tested in `core.checks`. Here is one
case for each field, and one for each rule of a class.
"""

import pytest

from mcspectra.core.errors import ParameterError
from mcspectra.samplers import sampler

REFUSED = [
    # (spec, dims, words of the message)
    ("sobol", 1112, ("sobol", "1111")),
    ("halton", 1001, ("halton", "1000")),
    ("halton(skip=-1)", 2, ("skip", "0")),
    ("halton(skip=1099511627776)", 2, ("skip",)),
    ("halton(scramble='nested')", 2, ("scramble", "none, permute, owen")),
    ("hammersley(scramble='faure')", 2, ("scramble", "none, permute, owen")),
    ("hammersley", 1001, ("hammersley", "1000")),
    ("van-der-corput(scramble='faure')", 1, ("scramble", "none, permute, owen")),
    ("van-der-corput(base=1)", 1, ("base", "8192")),
    ("van-der-corput(base=8193)", 1, ("base", "8192")),
    ("van-der-corput", 2, ("van-der-corput", "must be 1", "halton")),
    ("niederreiter", 1378, ("niederreiter", "1377")),
    ("larcher-pillichshammer", 3, ("must be 2", "sobol")),
    ("faure", 1001, ("faure", "1000")),
    *((f"faure(base={base})", 3, ("base is", "")) for base in (1, 2, 4, 9, 8193, 2.5, True)),
    *(
        (f"digital-net(matrices={given})", None, ("not a list of matrices",))
        for given in ([], None, 3, {}, [[{}]], [["x"]], [1, 2], [[]])
    ),
    ("digital-net(matrices=[[2, 4]])", None, ("matrices[0] is 4", "3")),
    ("digital-net(matrices=[[2, -1]])", None, ("matrices[0] is -1",)),
    ("digital-net(matrices=[[[1, 2], [0, 1]]])", None, ("matrices[0] is 2",)),
    ("digital-net(matrices=[[[1, 0], [1]]])", None, ("different lengths",)),
    ("digital-net(matrices=[[2, 1], [1]])", None, ("2x2, 1x1",)),
    ("digital-net(matrices=[[1]], base=1)", None, ("base is 1",)),
    ("digital-net(matrices=[[1]], digits=0)", None, ("digits is 0",)),
    ("digital-net(matrices=[[1]], digits=40, base=3)", None, ("3^rows", "2^53")),
    ("digital-net(matrices=[[1]])", 2, ("2 dims", "1 matrices")),
    ("rank1-lattice(vector=[1])", 2, ("vector has 1 components", "dims is 2")),
    ("rank1-lattice(vector=[])", 2, ("vector has 0 components",)),
    ("rank1-lattice(vector=[1, -3])", 2, ("vector[1] is -3",)),
    ("rank1-lattice(vector='15')", 2, ("vector is '15'", "list")),
    ("rank1-lattice(vector=5)", 2, ("vector is 5", "list")),
    ("korobov(a=0)", 2, ("a is 0", "1")),
    ("fibonacci", 1, ("must be 2", "korobov")),
    ("fibonacci", 3, ("must be 2", "korobov")),
    ("kronecker(alpha=[0.3])", 2, ("alpha has 1 value;",)),
    ("kronecker(alpha=[0.3, 0.2, 0.1])", 2, ("alpha has 3 values",)),
    ("kronecker(alpha=0.3)", 2, ("alpha is 0.3", "one for each dim")),
    ("kronecker(alpha='0.3')", 2, ("alpha is '0.3'", "one for each dim")),
    ("kronecker(alpha=[0.3, 'x'])", 2, ("alpha[1]",)),
    ("kronecker(alpha=[0.3, 2.0])", 2, ("alpha[1] is 2.0", "whole number")),
    ("kronecker(alpha=[0, 0.3])", 2, ("alpha[0] is 0", "whole number")),
    ("n-rooks", 1, ("must be 2", "latin-hypercube")),
    ("n-rooks", 3, ("must be 2", "latin-hypercube")),
    ("latin-hypercube(strength=3)", 2, ("strength is 3", "1 to 2")),
    ("latin-hypercube(strength=0)", 2, ("strength is 0",)),
    ("latin-hypercube(strength=2)", 1025, ("dims is 1025", "1024")),
    ("orthogonal-array(strength=1)", 2, ("strength is 1", "2 to 8")),
    ("orthogonal-array(strength=3)", 2, ("strength 3", "3 dims")),
    ("orthogonal-array", 1, ("2 dims", "jittered")),
    ("orthogonal-array", 1025, ("1024",)),
    ("orthogonal-array(strength=4)", 1000, ("lower the strength",)),
    ("orthogonal-array(jitter='mj')", 2, ("jitter is 'mj'", "correlated-multi-jittered")),
    ("projective-blue-noise(radius=0.001)", 2, ("radius is 0.001", "0.01")),
    ("projective-blue-noise(radius=1.5)", 2, ("radius is 1.5", "1")),
    ("projective-blue-noise", 7, ("projective-blue-noise", "6")),
    ("sliced-optimal-transport", 1, ("sliced-optimal-transport", "jittered")),
    ("sliced-optimal-transport(iterations=0)", 2, ("iterations is 0",)),
    ("sliced-optimal-transport(directions=1.5)", 2, ("directions is 1.5",)),
    # Randomizations alone
    *(
        (f"random | {step}(base={base})", 2, ("base is", "2 to 8192"))
        for step in ("digital-shift", "permute", "owen", "lms")
        for base in (1, 16384, "[2, 1]", "{}")
    ),
    ("sobol | owen(method='hsah')", 2, ("method", "'hsah'", "'hash'")),
    ("random | owen(method='hash', base=3)", 2, ("method='nested'",)),
    ("sobol | lms(shift=1)", 2, ("shift is 1", "True or False")),
    ("random | strata-shift(offset='x')", 2, ("offset is 'x'",)),
    ("random | strata-shift(offset=[0.5, None])", 2, ("offset[1]",)),
    ("sobol | random-rotation(boundary='any')", 2, ("boundary is 'any'", "toroidal, clipped")),
    ("sobol | mirror(mode='baker')", 2, ("mode is 'baker'", "random, uniform, fold")),
    ("sobol | decorrelate(mode='mirror')", 2, ("shift, digital-shift, owen",)),
    ("sobol | decorrelate(mask='blue')", 2, ("white, blue-noise, r2",)),
    ("sobol | decorrelate(width=0)", 2, ("width is 0", "256")),
    ("sobol | decorrelate(width=300)", 2, ("width is 300", "256")),
    ("sobol | decorrelate(mode='owen', mask='r2')", 2, ("mask", "white")),
    # Randomizations after a sampler
    ("sobol | owen(base=3)", 2, ("elementary intervals", "base 2")),
    ("halton | permute(base=2)", 2, ("elementary intervals", "2, 3")),
    ("halton | owen(method='hash')", 2, ("base 2", "(2, 3)")),
    ("random | owen(base=[2, 3, 5])", 2, ("base has 3 values",)),
    ("jittered | owen(base=4)", 2, ("strata", "one prime")),
    ("jittered | owen(base=[2, 3])", 2, ("strata", "one prime")),
    ("van-der-corput(base=4) | lms", 1, ("prime base", "base 4", "owen")),
    ("antithetic-jittered | lms", 2, ("lms", "pairs", "antithetic-jittered")),
    ("antithetic-jittered | digital-shift | owen", 2, ("owen", "pairs")),
    ("antithetic-jittered | digital-shift(jitter=True)", 2, ("digital-shift", "pairs")),
    ("sobol | digital-shift(jitter=2)", 2, ("jitter",)),
    ("korobov | lms", 2, ("lms", "distances")),
    ("korobov | owen", 2, ("owen", "distances", "shift")),
    ("random | strata-shift(offset=[0.1, 0.2, 0.3])", 2, ("offset has 3 values",)),
    ("jittered | random-rotation(boundary='clipped')", 3, ("2 dims", "jittered")),
    ("random | mirror(mode='uniform')", 31, ("31 dims", "30")),
    ("rank1-lattice | decorrelate(mode='owen')", 2, ("would break",)),
    ("halton | decorrelate(mode='digital-shift', mask='r2')", 2, ("halton", "base 3")),
]


@pytest.mark.parametrize(("spec", "dims", "words"), REFUSED)
def test_the_error_names_parameter_and_limit(spec, dims, words):
    with pytest.raises(ParameterError) as caught:
        sampler(spec, dims)
    sentence = str(caught.value)
    assert all(word in sentence for word in words), sentence
    assert sentence.endswith((".", "?"))
    assert "\n" not in sentence
