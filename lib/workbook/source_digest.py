"""A digest of what a module's source does: wording and layout are no part of it.

The keys of notebooks and of studies hold it.
"""

import ast
import contextlib
import hashlib
import threading

# Python 3.11 counts the depth of all syntax trees that are made at a time together: two threads disturb each other.
_ALONE = threading.Lock()
# Decorators that read no annotation.
SILENT = {
    *("property", "cached_property", "staticmethod", "classmethod", "cache", "lru_cache", "contextmanager"),
    *("kernel", "inlined_kernel", "borrowing_kernel", "pasted_kernel"),
}
TRIES = 20  # where a thread of another library makes one, too


def code_digest(source: bytes) -> str:
    """Digest of a module's `code`; source that Python cannot read has the digest of its bytes."""
    try:
        text = ast.dump(code(source)).encode(errors="surrogatepass")
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # the last two where it nests too deep
        text = source
    return hashlib.sha256(text).hexdigest()


def code(source: bytes) -> ast.Module:
    """A module's code without what cannot act when it runs.

    Left out are comments, blank lines, line breaks and brackets that change nothing, `pass`, strings that stand alone
    (docstrings among them), the annotations of functions and methods that no decorator but those of `SILENT` sees, and
    those of local variables. Kept are annotations that call or assign something, and those of other decorated
    functions, of fields and of a module's own names: validation, dataclasses and others that read annotations at run
    time find them there.
    """
    return _Acting().visit(_parsed(source))


def _parsed(source: bytes) -> ast.Module:
    for _ in range(TRIES):
        with contextlib.suppress(SystemError), _ALONE:
            return ast.parse(source)
    return ast.parse(source)


def _acting_part(annotation: ast.expr | None) -> ast.expr | None:
    """The annotation where Python does more than look names up when it defines the function; else None."""
    acts = annotation is not None and any(
        isinstance(part, ast.Call | ast.NamedExpr) for part in ast.walk(annotation)
    )
    return annotation if acts else None


def _decorator(node: ast.expr) -> str:
    """The last name of a decorator: `cache` of ``functools.cache`` and of ``cache(maxsize=4)``."""
    node = node.func if isinstance(node, ast.Call) else node
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


class _Acting(ast.NodeTransformer):
    """Removes what cannot act."""

    def __init__(self):
        self._around: type = ast.Module  # what the statement stands in: a module, a class or a function

    def visit_Expr(self, node):
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return None
        return self.generic_visit(node)

    def visit_Pass(self, node):
        return None

    def visit_ClassDef(self, node):
        return self._inside(ast.ClassDef, node)

    def visit_FunctionDef(self, node):
        if all(_decorator(each) in SILENT for each in node.decorator_list):
            node.returns = _acting_part(node.returns)
            each = node.args
            for argument in (*each.posonlyargs, *each.args, each.vararg, *each.kwonlyargs, each.kwarg):
                if argument is not None:
                    argument.annotation = _acting_part(argument.annotation)
        return self._inside(ast.FunctionDef, node)

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_AnnAssign(self, node):
        if self._around is ast.FunctionDef:  # Python never evaluates it there
            node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def _inside(self, kind: type, node):
        around, self._around = self._around, kind
        self.generic_visit(node)
        self._around = around
        return node
