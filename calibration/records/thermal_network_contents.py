# pyright: strict
"""A thermal network in the one form that records have (paper 2, 2.1)."""

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.thermal_network import AMBIENT, ThermalNetwork
from calibration.records.content_parts import quantity, record_table
from calibration.records.making import RecordContent, covariance_block
from calibration.records.record_parts import Model


def thermal_network_content(
    network: ThermalNetwork,
    power_w: FloatArray,
    time_s: FloatArray,
    measured_rise_k: FloatArray,
    first_rise_k: FloatArray,
) -> RecordContent:
    """Heat capacities and conductances, steady rises and the settling time with their joint covariance.

    Args:
        network: fitted.
        power_w: heat of each node, shape (n,).
        time_s: of a warm-up, shape (k,), for the table.
        measured_rise_k: above ambient, shape (k, n).
        first_rise_k: where the nodes began, shape (n,).
    """
    names = [f"heat_capacity_of_{node}" for node in network.nodes]
    names += [f"thermal_conductance_{one}_to_{other}" for one, other in network.edges]
    names += [f"steady_rise_of_{node}" for node in network.nodes] + ["settling_time"]
    count = len(network.nodes)
    units = ["J/(degC)"] * count + ["W/(degC)"] * len(network.edges) + ["degC"] * count + ["s"]
    symbols = [f"C_{k + 1}" for k in range(count)]
    symbols += [f"G_{k + 1}" for k in range(len(network.edges))]
    symbols += [f"r_{k + 1}" for k in range(count)] + ["t_95"]
    values, covariance = network.figures(power_w)
    covariance = 0.5 * (covariance + covariance.T)
    deviation = np.sqrt(np.diag(covariance))
    freedom = float(network.degrees_of_freedom)
    predicted = network.rise_k(time_s, power_w, first_rise_k)
    columns = [("time", "s", time_s)]
    columns += [(f"rise_of_{node}", "degC", measured_rise_k[:, k]) for k, node in enumerate(network.nodes)]
    residuals = [("time", "s", time_s)]
    residuals += [
        (f"residual_of_{node}", "degC", measured_rise_k[:, k] - predicted[:, k])
        for k, node in enumerate(network.nodes)
    ]
    there = np.isfinite(measured_rise_k).all(axis=0)
    keep = [0, *(k + 1 for k in np.flatnonzero(there).tolist())]
    return RecordContent(
        method="thermal_network",
        model=Model(
            name="thermal_network",
            equation=f"C dT/dt = P - L (T - T_{AMBIENT}), L = sum of G over the edges",
        ),
        quantities=tuple(
            quantity(name, symbol, float(value), unit, float(u), freedom)
            for name, symbol, value, unit, u in zip(names, symbols, values, units, deviation, strict=True)
        ),
        covariance=(covariance_block(names, covariance),),
        tables=(
            record_table("warm_up", *(columns[k] for k in keep)),
            record_table("residuals", *(residuals[k] for k in keep)),
        ),
    )
