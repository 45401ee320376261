"""A policy as one header of C99, which C++ takes too: no library but math.h, no memory but the stack, no state."""

import numpy as np
from jaxtyping import Float

from gpcjax.deploy.label import Label
from gpcjax.deploy.numerals import numerals, wrapped
from gpcjax.gp.smoothness import SQUARED_EXPONENTIAL
from gpcjax.policies.plain import Plain, PlainGrid, PlainKernel, PlainNetwork
from gpcjax.policies.vectors import FARTHEST

_CORRELATIONS = {
    0.5: "exp(-sqrt(squared))",
    1.5: "(1.0 + sqrt(squared)) * exp(-sqrt(squared))",
    2.5: "(1.0 + sqrt(squared) + squared / 3.0) * exp(-sqrt(squared))",
    SQUARED_EXPONENTIAL: "exp(-0.5 * squared)",
}

_TEMPLATE = """\
/*
{head}
 *
 * Needs math.h alone (link with -lm): no memory beyond {stack} of the stack, no state, so that
 * several threads may call it. Include it where it is called. No -ffast-math: NaN has to stay NaN.
 *
 * Provenance:
{provenance}
 */
#ifndef {guard}
#define {guard}

#include <math.h>

#define {upper}_OBS_SIZE {obs_size}
#define {upper}_ACTION_SIZE {action_size}

/* obs: {obs_size} numbers, read. action: {action_size} from -1 to 1, written. They must not overlap. */
static inline void {name}_act(const double *obs, double *action)
{{
    double seen[{obs_size}];
    int k;
    for (k = 0; k < {obs_size}; k++) {{
        seen[k] = obs[k] < -{farthest!r} ? -{farthest!r} : obs[k] > {farthest!r} ? {farthest!r} : obs[k];
    }}
{body}
}}

#endif
"""

_KERNEL = """\
{scale}
{points}
{weights}
    int a, p, i;
    for (a = 0; a < {actions}; a++) {{
        double place[{size}], total = 0.0;
        for (i = 0; i < {size}; i++) {{
            place[i] = seen[i] * scale[a * {size} + i];
        }}
        for (p = 0; p < {count}; p++) {{
            double squared = 0.0;
            for (i = 0; i < {size}; i++) {{
                const double difference = points[(a * {count} + p) * {size} + i] - place[i];
                squared += difference * difference;
            }}
            total += weights[a * {count} + p] * ({correlation});
        }}
        action[a] = {clipped};
    }}"""

_GRID = """\
    static const int counts[{size}] = {{
{counts}
    }};
{lower}
{upper}
{weights}
    double shares[{shares}], *share = shares;
    int a, c, i;
    for (i = 0; i < {size}; i++) {{
        const double spacing = (upper[i] - lower[i]) / (counts[i] - 1);
        double largest = 0.0, total = 0.0;
        for (c = 0; c < counts[i]; c++) {{
            const double distance = (seen[i] - lower[i]) / spacing - c;
            share[c] = -0.5 * distance * distance;
            largest = c == 0 || share[c] > largest ? share[c] : largest;
        }}
        for (c = 0; c < counts[i]; c++) {{
            share[c] = exp(share[c] - largest);
            total += share[c];
        }}
        for (c = 0; c < counts[i]; c++) {{
            share[c] /= total;
        }}
        share += counts[i];
    }}
    for (a = 0; a < {actions}; a++) {{
        int cell[{size}] = {{0}};
        double total = 0.0;
        for (c = 0; c < {cells}; c++) {{
            double product = weights[a * {cells} + c];
            share = shares;
            for (i = 0; i < {size}; i++) {{
                product *= share[cell[i]];
                share += counts[i];
            }}
            total += product;
            for (i = {size} - 1; i >= 0 && ++cell[i] == counts[i]; i--) {{
                cell[i] = 0;
            }}
        }}
        action[a] = {clipped};
    }}"""

_LAYER = """\
    for (o = 0; o < {outputs}; o++) {{
        double total = biases_{layer}[o];
        for (i = 0; i < {inputs}; i++) {{
            total += weights_{layer}[o * {inputs} + i] * {source}[i];
        }}
        {target}[o] = {value};
    }}"""

_CLIPPED = "total < -1.0 ? -1.0 : total > 1.0 ? 1.0 : total"


def c_header(plain: Plain, label: Label) -> str:
    """The text of the header: `void NAME_act(const double *obs, double *action)`, as `plain.act` to rounding."""
    body, stack = _written(plain)
    return _TEMPLATE.format(
        head=_comment(label.head),
        provenance=_comment(label.provenance),
        guard=f"GPCJAX_POLICY_{label.name.upper()}_H",
        upper=label.name.upper(),
        name=label.name,
        obs_size=plain.obs_size,
        action_size=plain.action_size,
        stack=f"{8 * (stack + plain.obs_size):,} bytes",
        farthest=FARTHEST,
        body=body,
    )


def _written(plain: Plain) -> tuple[str, int]:
    """The statements that make `action` of `obs`, and how many numbers they keep on the stack."""
    match plain:
        case PlainKernel():
            arrays = {name: _array(name, getattr(plain, name)) for name in ("scale", "points", "weights")}
            body = _KERNEL.format(
                **arrays,
                size=plain.obs_size,
                count=plain.points.shape[1],
                actions=plain.action_size,
                correlation=_CORRELATIONS[plain.smoothness],
                clipped=_CLIPPED,
            )
            return body, plain.obs_size
        case PlainGrid():
            arrays = {name: _array(name, getattr(plain, name)) for name in ("lower", "upper", "weights")}
            body = _GRID.format(
                **arrays,
                size=plain.obs_size,
                counts=wrapped(map(str, plain.counts), " " * 8),
                shares=sum(plain.counts),
                cells=int(np.prod(plain.counts)),
                actions=plain.action_size,
                clipped=_CLIPPED,
            )
            return body, sum(plain.counts) + plain.obs_size
        case PlainNetwork():
            return _network(plain)
    raise TypeError(f"no header for a {type(plain).__name__}")


def _network(plain: PlainNetwork) -> tuple[str, int]:
    arrays, loops, source, inputs, units = [], [], "seen", plain.obs_size, []
    for layer, (weights, biases) in enumerate(zip(plain.weights, plain.biases, strict=True), 1):
        arrays += [_array(f"weights_{layer}", weights), _array(f"biases_{layer}", biases)]
        last = layer == len(plain.weights)
        outputs = len(biases)
        # What is squashed is within [-1, 1] by itself.
        value = _CLIPPED if last and not plain.squashed else "tanh(total)"
        target = "action" if last else f"units_{layer}"
        if not last:
            units.append(f"    double units_{layer}[{outputs}];")
        loops.append(
            _LAYER.format(
                layer=layer, inputs=inputs, outputs=outputs, source=source, target=target, value=value
            )
        )
        source, inputs = target, outputs
    return "\n".join([*arrays, *units, "    int i, o;", *loops]), sum(map(len, plain.biases[:-1]))


def _array(name: str, values: Float[np.ndarray, "..."]) -> str:
    return f"    static const double {name}[{values.size}] = {{\n{numerals(values, ' ' * 8)}\n    }};"


def _comment(lines: tuple[str, ...]) -> str:
    return "\n".join(f" * {line}".rstrip() for line in lines)
