// Complex arrays as two arrays of numbers, and grids of frequencies.

export function complexArray(length, real = 0, imaginary = 0) {
  return { re: new Float64Array(length).fill(real), im: new Float64Array(length).fill(imaginary) };
}

export function multiplyInto(a, b) {
  for (let k = 0; k < a.re.length; k++) {
    const re = a.re[k] * b.re[k] - a.im[k] * b.im[k];
    a.im[k] = a.re[k] * b.im[k] + a.im[k] * b.re[k];
    a.re[k] = re;
  }
  return a;
}

export function magnitude(a) {
  const size = new Float64Array(a.re.length);
  for (let k = 0; k < size.length; k++) size[k] = Math.hypot(a.re[k], a.im[k]);
  return size;
}

export const toDb = (size) => 20 * Math.log10(size);

export function geomspace(low, high, count) {
  const ratio = Math.log(high / low) / (count - 1);
  const values = Float64Array.from({ length: count }, (_, k) => low * Math.exp(ratio * k));
  values[count - 1] = high;
  return values;
}

export function sortedUnique(values) {
  const sorted = Float64Array.from(values).sort();
  return sorted.filter((value, k) => k === 0 || value !== sorted[k - 1]);
}

// Frequencies from low to high (rad/s), and more around each pole {omega, width}, dense at its width: a grid in
// logarithms alone steps over lightly damped modes.
export function resonanceGrid(poles, low, high, points, around) {
  const values = [...geomspace(low, high, points)];
  for (const { omega, width } of poles) {
    const least = Math.max(width, 1e-7 * omega), reach = Math.asinh((0.5 * omega) / least);
    for (let k = -around; k <= around; k++) values.push(omega + least * Math.sinh((reach * k) / around));
  }
  return sortedUnique(values.filter((omega) => omega >= low && omega <= high));
}
