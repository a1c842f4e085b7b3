"""Draw your own controller, fly it in place of the stock one, tune it, and keep it as a file."""

from math import degrees

from twodof.blocks import Diagram
from twodof.blocks.library import Gain, LowPass, Saturation, Sum
from twodof.experiment import Laboratory
from twodof.flight.starters import save_diagram
from twodof.flight.templates import ATTITUDE, check_template
from twodof.flightlog import setpoint_steps
from twodof.models import step_figures

# A template's ports are its table: a diagram with exactly these can take the stock controller's place.
d = Diagram("state_feedback", "M = k_theta (theta_0 - theta) - k_q q, q through a low-pass")
for port in ATTITUDE.inputs:
    d.input(port.name, port.kind, unit=port.unit)
d.param("k_theta", 1.0, unit="1/rad", low=0.0, high=5.0, text="gain on the pitch error")
d.param("k_q", 0.09, unit="s/rad", low=0.0, high=0.5, text="gain on the pitch rate")
d.add("error", Sum("+-", unit="rad"), a="theta_0", b="theta")
d.add("filter", LowPass(40.0, unit="rad/s"), u="q")
d.add("spring", Gain(), params={"k": "k_theta"}, u="error")
d.add("damper", Gain(), params={"k": "k_q"}, u="filter")
d.add("moment", Sum("+-"), a="spring", b="damper")
d.add("limit", Saturation(-0.4, 0.4), u="moment")
d.output("M", "limit")
check_template(d)  # names each port that does not fit

laboratory = Laboratory("lab", controllers=[d], noise=0.0)
print(f"{'k_theta':>8} {'rise, s':>8} {'overshoot, %':>13} {'error at end, deg':>18} {'largest M':>10}")
for k_theta in (0.5, 1.0, 2.0):
    # A parameter of the diagram is one of the compiled closed loop: another value needs no other program.
    laboratory.loop.tune_controllers({"attitude_control.k_theta": k_theta})
    log = laboratory.fly("attitude-steps").log
    first, second = (event.time for event in setpoint_steps(log, "theta0")[:2])
    response = log["theta_true"].slice(first, second - 0.01)
    asked = log.resample("theta0", [first + 1.0]).item()
    seen = step_figures(response.time - first, response.value, start=0.0, final=asked)
    left = degrees(asked - response.value[-25:].mean())
    largest = abs(log["M"].slice(first, second).value).max()
    print(f"{k_theta:8.2f} {seen.rise_time:8.3f} {100.0 * seen.overshoot:13.1f} {left:18.2f} {largest:10.3f}")

save_diagram(d, "state_feedback.json", overwrite=True)
print("kept: state_feedback.json; fly it with: twodof simulate attitude-steps --controller state_feedback.json")
