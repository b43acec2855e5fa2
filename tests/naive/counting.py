"""Numbers that count their multiplications and divisions, and the updates written with them."""


class Counted:
    """A float with a shared counter of multiplications and divisions."""

    count = 0

    def __init__(self, value):
        self.value = float(value)

    def __add__(self, other):
        return Counted(self.value + value_of(other))

    __radd__ = __add__

    def __sub__(self, other):
        return Counted(self.value - value_of(other))

    def __neg__(self):
        return Counted(-self.value)

    def __mul__(self, other):
        Counted.count += 1
        return Counted(self.value * value_of(other))

    __rmul__ = __mul__

    def __truediv__(self, other):
        Counted.count += 1
        return Counted(self.value / value_of(other))

    def __rtruediv__(self, other):
        Counted.count += 1
        return Counted(value_of(other) / self.value)

    def __gt__(self, other):
        return self.value > value_of(other)


def value_of(number):
    return number.value if isinstance(number, Counted) else float(number)


def counted(array):
    """Nested lists of `Counted` from an array."""
    return Counted(array) if getattr(array, "ndim", 0) == 0 else [counted(row) for row in array]


def product(a, b):
    """Dense matrix product of nested lists."""
    return [
        [total(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)]
        for row in a
    ]


def total(terms):
    terms = list(terms)
    result = terms[0]
    for term in terms[1:]:
        result = result + term
    return result


def inverse(matrix):
    """Inverse in place after Gauss and Jordan, without pivoting: N reciprocals and N³ - N products."""
    a = [list(row) for row in matrix]
    n = len(a)
    for p in range(n):
        pivot = 1 / a[p][p]
        a[p][p] = pivot
        for j in range(n):
            if j != p:
                a[p][j] = a[p][j] * pivot
        for i in range(n):
            if i != p:
                factor = a[i][p]
                for j in range(n):
                    if j != p:
                        a[i][j] = a[i][j] - factor * a[p][j]
                a[i][p] = Counted(0) - factor * pivot
    return a
