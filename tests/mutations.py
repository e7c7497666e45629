"""Seeded defects: `python -m tests.mutations [PACKAGE …]` reports whether the tests find each one.

An entry of `MUTATIONS` is a package, a fragment that occurs exactly once in its source, and the
defect that replaces the fragment in a copy of the repository. The tests of the package run first;
then the tests that `BEYOND` lists for the fragment. The program prints a line for each defect; its
exit code is 1 if the tests missed a defect. A defect takes about a minute.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Tests of other packages that find a defect which the package's own tests miss
BEYOND = {
    "if np.ma.is_masked(value):": "tests/test_bad_input.py",
    '"bias_se": np.hypot(mean_se, known),': "tests/estimators",
    "level=np.where(enough, level, np.nan),": "tests/rendering/test_map_parts.py",
}
MUTATIONS = [
    ("core", "x ^= x >> _S29", "x ^= x >> _S32"),
    (
        "core",
        "a, b, c, d = (q >> _S32) ^ b ^ k0, q & _LOW32, (p >> _S32) ^ d ^ k1, p & _LOW32",
        "a, b, c, d = (q >> _S32) ^ b ^ k0, q & _LOW32, (p >> _S32) ^ d ^ k0, p & _LOW32",
    ),
    (
        "core",
        "slope = float((weight * off * y).sum()) / spread",
        "slope = float((off * y).sum()) / float((off**2).sum())",
    ),
    (
        "core",
        "chi2 = float((weight * residuals**2).sum() / degrees) if degrees else math.nan",
        "chi2 = float((weight * residuals**2).sum() / len(x)) if degrees else math.nan",
    ),
    (
        "core",
        "word, _ = _philox4x32(np.uint64(self.key), label, 0, 0, 1)",
        "word, _ = _philox4x32(np.uint64(self.key), label, 0, 0, 0)",
    ),
    ("core", "if np.ma.is_masked(value):", "if False and np.ma.is_masked(value):"),
    (
        "samplers",
        "row[i] = corners[i] + side * mix_uniform(k0, k1, i)",
        "row[i] = corners[i] + side * mix_uniform(k0, k1, i + 1)",
    ),
    (
        "samplers",
        "out[r, i, j] = x - 1.0 if x >= 1.0 else x",
        "out[r, i, j] = x - 1.0 if x > 1.0 else x",
    ),
    (
        "samplers",
        "out[r, i, j] = order[i] / n + side * mix_uniform(k0, k1, i * dims + j)",
        "out[r, i, j] = order[i] / n + side * mix_uniform(k0, k1, i * dims)",
    ),
    (
        "samplers",
        "out[r, i, 1, j] = corners[i, j] + side * (BELOW_ONE - u)",
        "out[r, i, 1, j] = corners[i, j] + side * u",
    ),
    (
        "samplers",
        "x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))",
        "x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C57)))",
    ),
    (
        "samplers",
        "chosen = t + _mix_below(k0, k1, number + t, order.size - t)",
        "chosen = t + _mix_below(k0, k1, number, order.size - t)",
    ),
    (
        "samplers",
        "return _powers(_best_generator(n, self.dims) if self.a is None else self.a, n, self.dims)",
        "return _powers(2 if self.a is None else self.a, n, self.dims)",
    ),
    (
        "samplers",
        "options = tuple(c for c in (below, above) if c is not None and c <= MAX_COUNT)",
        "options = (below,)",
    ),
    ("densities", "return np.asarray(x * rest)", "return np.asarray(x * rest * (1.0 - 1e-7))"),
    (
        "densities",
        "low += half * (borders[low + half] <= u)",
        "low += half * (borders[low + half] < u)",
    ),
    (
        "densities",
        "u = borders[i] + (x * cells - i) * width",
        "u = borders[i] + (x * cells - i) * width * 0.999",
    ),
    (
        "densities",
        'x = self._sample(as_points(u, self.primary_dims, "u"))',
        "x = self._sample(np.asarray(u, float))",
    ),
    ("densities", "if i < cells - 1 and x >= (i + 1) / cells:", "if False:"),
    (
        "integrands",
        "return mean, mean**2 + ((hi - lo) ** 2 @ self._slopes**2) / 12.0",
        "return mean, mean**2 + ((hi - lo) ** 2 @ self._slopes**2) / 6.0",
    ),
    (
        "integrands",
        "return np.where(count == 1, 0.5j / np.pi * along, np.where(count, 0.0, self._integral()))",
        (
            "return np.where(count == 1, -0.5j / np.pi * along, np.where(count, 0.0, "
            "self._integral()))"
        ),
    ),
    (
        "integrands",
        "return sum(c / (k + 1) for k, c in enumerate(self.coefficients)) ** self.dims",
        "return sum(c / (k + 1) for k, c in enumerate(self.coefficients)) * self.dims",
    ),
    ("integrands", "if not in_unit_cube(points):", "if False:"),
    (
        "estimators",
        "left = self.integrand(x) - self.combination.offset(x)",
        "left = self.integrand(x) + self.combination.offset(x)",
    ),
    ("estimators", "spread = (drawn - (n - 3) / (n - 1)) / n", "spread = (drawn - 1.0) / n / 2"),
    (
        "estimators",
        "+ 3 * delta * (a * other.m2 - b * self.m2) / n,",
        "+ 3 * delta * (a * other.m2 + b * self.m2) / n,",
    ),
    ("estimators", "return drawn * len(counts)", "return drawn"),
    (
        "estimators",
        "order = np.argsort(keys, axis=2)[..., None]",
        "order = np.argsort(np.zeros_like(keys), axis=2)[..., None]",
    ),
    ("quality", "product *= 2.0 - max(x[i, k], x[j, k])", "product *= 2.0 - min(x[i, k], x[j, k])"),
    (
        "quality",
        "worst = max(worst, share - left * heights[k], right * heights[k + 1] - share)",
        "worst = max(worst, share - left * heights[k])",
    ),
    ("spectra", "second[h] = -0.5j * (a - b)", "second[h] = 0.5j * (a - b)"),
    ("spectra", "squares[h] += p * p + q * q", "squares[h] += p * p"),
    (
        "spectra",
        "return np.asarray(reciprocal / n + (n - 1) / n * np.abs(_product(_interval(nu))) ** 2)",
        "return np.asarray(reciprocal / n + np.abs(_product(_interval(nu))) ** 2)",
    ),
    (
        "spectra",
        "cell = cell * size + int(points[r, k, j] * size)",
        "cell = cell * size + int(points[r, k, dims - 1 - j] * size)",
    ),
    (
        "spectra",
        "total[h] += 0.5 * ((a + b) - 1j * (a - b))",
        "total[h] += 0.5 * ((a + b) + 1j * (a - b))",
    ),
    (
        "measure",
        "dc, power, total = sums.T / max(self.count - 1, 1)",
        "dc, power, total = sums.T / max(self.count, 1)",
    ),
    (
        "measure",
        "return np.asarray((f.conj() * self.cov).real / max(self.count - 1, 1))",
        "return np.asarray((f * self.cov).real / max(self.count - 1, 1))",
    ),
    ("measure", '"bias_se": np.hypot(mean_se, known),', '"bias_se": mean_se,'),
    (
        "core",
        "curvature = (straight * residual).sum() ** 2 / (straight**2).sum()",
        "curvature = 0.0",
    ),
    (
        "measure",
        "np.rint(angle / np.pi * wedges).astype(np.int64) % wedges",
        "np.floor(angle / np.pi * wedges).astype(np.int64) % wedges",
    ),
    (
        "measure",
        "others[t] = np.take_along_axis(y, keys.argsort(axis=1)[:, :, None], axis=1)",
        "others[t] = y",
    ),
    (
        "measure",
        'band_m2=np.einsum("rca,rcb->cab", deviation, deviation),',
        'band_m2=np.einsum("rca,rcb->cab", bands, bands),',
    ),
    (
        "measure",
        "a * b / (a + b), b / (a + b)\n        delta = other.mean - self.mean\n        shift",
        "a * a / (a + b), b / (a + b)\n        delta = other.mean - self.mean\n        shift",
    ),
    (
        "core",
        "used = (variance > floor) & np.isfinite(relative_se) & (relative_se > 0)",
        "used = np.isfinite(relative_se) & (relative_se > 0)",
    ),
    (
        "studies",
        'either = int(self.digest, 16) ^ int.from_bytes(digest, "big")',
        "either = int(self.digest, 16)",
    ),
    (
        "core",
        "left, right = (state, other) if first & count == 0 else (other, state)",
        "left, right = (state, other)",
    ),
    (
        "studies",
        "return first % size == 0 and (size == count or first + count == self.reduction.blocks)",
        "return True",
    ),
    (
        "studies",
        "config = msgspec.structs.replace(config, time_limit=None)",
        "config = config",
    ),
    (
        "studies",
        "if first < position or not self._aligned(first, count):",
        "if not self._aligned(first, count):",
    ),
    (
        "rendering",
        "used = (variance > floor) & (relative_se > 0) & (relative_se <= largest_se)",
        "used = (relative_se > 0) & (relative_se <= largest_se)",
    ),
    ("rendering", "se = total**-0.5 if independent else together", "se = total**-0.5"),
    ("core", "level=np.where(enough, level, np.nan),", "level=level,"),
    (
        "plots",
        'mantissa, exponent = f"{abs(value):.{digits - 1}e}".split("e")',
        'mantissa, exponent = f"{abs(value):.{digits}e}".split("e")',
    ),
    ("plots", "half = (high - low) / 2", "half = high - low"),
    (
        "estimators",
        "half = math.hypot(*((each.high - each.low) / 2 for each in (self, other)))",
        "half = (self.high - self.low) / 2",
    ),
    ("reproduction", "_VERDICT_Z = 3.7584590197611987", "_VERDICT_Z = 37.584590197611987"),
    (
        "cli",
        'code, sentence = 2, "Not enough memory; use fewer points, dims or frequencies."',
        'code, sentence = 1, "Not enough memory; use fewer points, dims or frequencies."',
    ),
    ("cli", "        return 130", "        return 1"),
    (
        "report",
        "return percent(abs(row.cross or 0.0) / ((row.dc or 0.0) + (row.power or 0.0) or 1.0))",
        "return percent(abs(row.cross or 0.0) / ((row.power or 0.0) or 1.0))",
    ),
    (
        "report",
        (
            "adding = {name: value for name, value in sizes.items() if value is not None and "
            "value > 0}"
        ),
        (
            "adding = {name: value for name, value in sizes.items() if value is not None and "
            "value < 0}"
        ),
    ),
    (
        "app",
        'weights = 1.0 / parts.density.pdf(found["points"].to_numpy())',
        'weights = parts.density.pdf(found["points"].to_numpy())',
    ),
    ("app", "if self.counts and max(self.counts) > MOST_POINTS:", "if False:"),
    (
        "plots",
        "threshold = 10.0 ** math.floor(math.log10(least))",
        "threshold = 10.0 ** math.ceil(math.log10(least))",
    ),
]


def main(*packages):
    """Try the defects of the given packages, by default of all packages."""
    survivors = 0
    for package, found, instead in MUTATIONS:
        if packages and package not in packages:
            continue
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder, "copy")
            ignored = shutil.ignore_patterns(".git", ".venv", "out", "build")
            shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
            sources = (copy / "src/mcspectra" / package).rglob("*.py")
            (path,) = (p for p in sources if found in p.read_text(encoding="utf-8"))
            text = path.read_text(encoding="utf-8")
            assert text.count(found) == 1, f"{found!r} occurs several times in {path}"
            path.write_text(text.replace(found, instead), encoding="utf-8")
            killed = next(
                (t for t in (f"tests/{package}", BEYOND.get(found)) if t and _fails(copy, t)), None
            )
        survivors += killed is None
        print(f"{package:12s} {killed or 'NOT FOUND':26s} {found.strip()[:90]}", flush=True)
    return int(survivors > 0)


def _fails(copy, tests):
    command = (sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", tests)
    environment = os.environ | {"PYTHONPATH": str(copy / "src")}
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, check=False)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{tests} could not run: {done.stdout.decode()[-2000:]}")
    return done.returncode == 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
