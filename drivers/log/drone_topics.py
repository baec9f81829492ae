"""Topics that any drone's program logs: its setup, frames, state, link and end."""

from __future__ import annotations

from drivers.log.topic_fields import (
    CAMERA,
    Topic,
    box,
    flag,
    number,
    numbers,
    reason,
    table,
    tables,
    text,
    whole,
)

DRONE: dict[str, Topic] = {
    "/setup": Topic(
        "what the program was given; first. Poses are the upper three rows of their matrices, one after another",
        {
            "role": text("sender (D1) or receiver (D2)"),
            "rig": text("its name"),
            "level": text("sim, sim-rendered, sitl, hitl or field"),
            "handoff_id": whole("of the mission"),
            "target_id": whole("of the target"),
            "method": table("settings of the method: path.config.MethodConfig"),
            "mission": table("settings of the mission: flight.config.MissionConfig"),
            "camera": table("this drone's", **CAMERA),
            "peer_camera": table("the other drone's", **CAMERA),
            "T_b_c": numbers("this drone's camera to its body (FRD), m"),
            "T_b_v": numbers("the marker's frame to the sender's body (FRD), m"),
            "T_v_c1": numbers("the sender's camera to the marker's frame, m"),
            "markers_v_m": numbers(
                "x, y, z of the four corners of every marker, marker's frame, m"
            ),
            "origin": numbers(
                "latitude and longitude in degrees, altitude in m, of the local frame's zero"
            ),
            "fence_m": numbers(
                "radius about the origin and height, beyond which nothing is flown, m"
            ),
        },
    ),
    "/frame": Topic(
        "a camera frame whose cycle began; the stamp is the capture",
        {
            "frame_id": whole("of the camera; it only grows"),
            "age_ns": whole("capture to begin of the cycle, ns"),
            "ground_down_m": number(
                "of D1, where it is known: how far down the ground is in its frame, m"
            ),
            "ground_sigma_m": number("standard deviation of that, m"),
            "ground_by": text("what it is known by: ground (its own height) or rangefinder"),
            "T_n_c": numbers(
                "camera to north-east-down as believed, of D1 with record = all: rows of its matrix, m"
            ),
        },
    ),
    "/recording": Topic(
        "frames recorded beside the log, once a second; counters are from the program's start",
        {
            "taken": whole("frames that were to be recorded"),
            "dropped": whole("of them not recorded: encoder or disk did not keep up"),
            "bytes": whole("of the file"),
            "spent_ns": whole("of processor, in real time only, ns"),
        },
    ),
    "/cpu": Topic(
        "processor time, once a second, in real time only",
        {
            "spent_ns": table(
                "ns since the start by stage; thread: the main thread; program: all threads"
            )
        },
    ),
    "/late": Topic(
        "the program was late, was given no core, or stood for a disk; in real time only",
        {
            "since_ns": whole("until the record's stamp, ns: the time that it is of"),
            "loop_ns": whole(
                "its event loop woke so much later than it had asked for, whatever the reason, ns"
            ),
            "waited_ns": whole("its main thread was ready to run and had no core, ns"),
            "beside_ns": whole("the longest that any other of its threads had none, ns"),
            "stolen_ns": whole("the most that a virtual machine's host took from one core, ns"),
            "disk_ns": whole("its main thread stood for a disk, ns"),
        },
    ),
    "/shed": Topic(
        "something is given up because the computer does not keep up, or taken up again; in real time only",
        {
            "what": text("of flight.shedding.IN_ORDER"),
            "gone": flag("given up, not taken up again"),
            "busy": number("share of the time at work before, 0 to 1"),
        },
    ),
    "/phase": Topic(
        "a phase of the course begins", {"phase": text("its name"), "note": text("for the crew")}
    ),
    "/note": Topic("a line for the crew", {"note": text("the line")}),
    "/state": Topic(
        "where the vehicle believes to be, ten times a second; what its estimator stepped by is taken out",
        {
            "position_n_m": numbers("north, east, down in m from the origin of the rig"),
            "velocity_n_mps": numbers("north, east, down in m/s"),
            "q_n_b": numbers("attitude, quaternion wxyz, body (FRD) to north-east-down"),
            "mode": text("flight mode"),
            "armed": flag("motors may turn"),
            "battery": number("what is left, 0 to 1"),
            "gps_fix": whole("of its GPS: MAVLink's GPS_FIX_TYPE, from 3 on it has a place"),
            "satellites": whole("that its GPS uses; 255: it does not say"),
            "radio": flag("the pilot's radio is heard"),
        },
    ),
    "/estimator_step": Topic(
        "the vehicle's estimate stepped; the flight goes on without the step. Stamped with the first state after",
        {
            "before_ns": whole("stamp of the last state before, own clock"),
            "shift_n_m": numbers(
                "how much farther the place is than before: north, east, down in m"
            ),
            "turn_rad": number("how much farther clockwise the heading is than before, rad"),
            "counted": flag("the autopilot's count of its resets changed too"),
        },
    ),
    "/peer": Topic(
        "what the other drone said of itself last, once a second while it is heard",
        {
            "role": text("its role"),
            "phase": text("its phase's name"),
            "position_n_m": numbers("north, east, down in the mission's local frame, m"),
            "velocity_n_mps": numbers("north, east, down in m/s"),
            "yaw_rad": number("its heading from north, rad"),
            "responsible": flag("for the target, as it says"),
            "battery": number("what is left, 0 to 1"),
            "ended": text("what its flight has ended in; empty while it goes on"),
        },
    ),
    "/peer_step": Topic(
        "the other drone said that its estimator stepped: evidence is gathered anew from here on",
        {"steps": whole("how often it has, modulo 64")},
    ),
    "/alike": Topic(
        "what both drones must have alike was compared, before anything moved",
        {
            "differing": text(
                "what they have not alike, the first cause first; empty when they agree"
            )
        },
    ),
    "/home": Topic(
        "the drone stands where the crew put it down, before take-off",
        {
            "off_m": numbers(
                "how far its position is off there, north and east in m; 0 where no home is stated"
            )
        },
    ),
    "/told": Topic(
        "D1 was told something of which object is meant; places are in its own frame",
        {
            "kind": text("place, bearing, region or choice"),
            "at_ns": whole("the instant that is spoken of, own clock"),
            "used": flag("it was of use: an answer may come when the object is not known any more"),
            "place_n_m": numbers("north, east, down in m"),
            "error_m": number("standard deviation of the place on each axis, m"),
            "height_told": flag("down was said too"),
            "velocity_n_mps": numbers("north and east in m/s, where it was said"),
            "holds_s": number("for so long it is said to stand, or to go on so, s"),
            "from_n_m": numbers("north and east of who saw it in that direction, m"),
            "bearing_rad": number("clockwise from north, rad"),
            "error_rad": number("standard deviation of that, rad"),
            "corners_n_m": numbers("north, east of one corner after another, m"),
            "question": whole("that is answered"),
            "number": whole("of the object that was chosen; 0: none of those shown"),
        },
    ),
    "/question": Topic(
        "D1 asks which of several objects is meant",
        {
            "number": whole("of the question"),
            "capture_ns": whole("of the frame that is shown"),
            "shown": tables(
                "the objects",
                number=whole("its number"),
                box=box("in that frame"),
                place_n_m=numbers("north, east, down in m"),
                share=number("probability that it is the one, by all that was said"),
            ),
        },
    ),
    "/taken": Topic(
        "D1 takes an object for its target; the stamp is the capture",
        {
            "position_n_m": numbers("north, east, down in m"),
            "velocity_n_mps": numbers("north, east, down in m/s"),
            "share": number("probability that it is the one meant"),
            "chosen": flag("by somebody who was asked"),
        },
    ),
    "/setpoint": Topic(
        "what the vehicle was told",
        {
            "velocity_n_mps": numbers("north, east, down in m/s"),
            "yaw_rad": number("heading from north, rad"),
        },
    ),
    "/doubt": Topic(
        "whether the pilot has taken the vehicle is not known for a moment",
        {"mode": text("flight mode as heard"), "armed": flag("motors may turn")},
    ),
    "/responsibility": Topic(
        "whose the target is, when that changes",
        {
            "responsible": flag("this drone's"),
            "until_ns": whole(
                "end of its lease, own clock; left out: for good. Nobody need say that it is over"
            ),
        },
    ),
    "/link": Topic(
        "the link between the drones, once a second; counters are from the program's start",
        {
            "packets_sent": whole("packets"),
            "packets_received": whole("packets"),
            "bytes_sent": whole("bytes, UDP and IP headers included"),
            "bytes_received": whole("bytes, UDP and IP headers included"),
            "dropped": table("packets by reason"),
            "clock_offset_ns": whole("clock of the other drone minus this one's, ns"),
            "clock_uncertainty_ns": whole("bound on the error of that, ns"),
        },
    ),
    "/track": Topic(
        "a drone that follows the target on its own: what a frame gave",
        {"box": box("the target"), "reason": reason("there is no box")},
    ),
    "/outcome": Topic(
        "the end of the program",
        {
            "outcome": text("see docs/faults.md"),
            "detail": text("what was seen"),
            "responsible": flag("for the target, at the end"),
            "landed": flag("by the script"),
        },
    ),
}
