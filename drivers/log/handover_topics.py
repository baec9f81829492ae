"""Topics of a hand-over: the protocol's, and every frame of the sender (D1) and of the receiver
(D2).
"""

from __future__ import annotations

from drivers.log.topic_fields import (
    ATTEMPT,
    CAPTURE,
    Topic,
    box,
    flag,
    number,
    numbers,
    reason,
    tables,
    text,
    whole,
)

HANDOVER: dict[str, Topic] = {
    # --- protocol of the hand-over ---
    "/commit": Topic(
        "D1 gives the target away, until the lease's end",
        {
            "target_id": whole("of the target"),
            "epoch": whole("of the attempt"),
            "nonce": whole("by chance"),
            "lease_end_ns": whole("ns of D1's clock"),
        },
    ),
    "/epoch": Topic(
        "what was written down to survive a restart",
        {"epoch": whole("of the attempt"), "duty": text("what the drone has to do about it")},
    ),
    "/decision": Topic(
        "how an attempt ended",
        {"outcome": text("path.protocol.values.HandoffOutcome"), "reason": text("of an abort")},
    ),
    "/settled": Topic(
        "what became known later of an attempt",
        {"outcome": text("path.protocol.values.HandoffOutcome")},
    ),
    "/refused": Topic(
        "what the protocol did not let happen", {"why": text("path.protocol.values.Refusal")}
    ),
    "/attempt": Topic("from here on a cycle of its own decides: another attempt", ATTEMPT),
    # --- D1 ---
    "/heard_candidate": Topic(
        "an answer of D2 as it came in, once the clocks are aligned",
        {
            **ATTEMPT,
            "sequence": whole("low 16 bits of D2's frame"),
            "target_sequence": whole("of the message of D1 that it answers"),
            "peer_capture_ns": whole("of D2's frame, ns of D2's clock"),
            "capture_ns": whole("the same, ns of D1's clock"),
            "box": box("what D2 takes for the target"),
            "reason": reason("there is no box"),
            "position_v_m": numbers("of D2's camera in the marker's frame, m"),
            "rotation_v_c2": numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": number("standard deviation of the position, each axis, m"),
        },
    ),
    "/target": Topic(
        "one frame of D1: the message sent to D2, or why there is none",
        {
            "frame_id": whole("of the camera"),
            "sequence": whole("low 16 bits of that"),
            "capture_ns": CAPTURE,
            "judged_ns": whole("when answers of D2 were judged after it, ns of this log's clock"),
            "box": box("the target as tracked"),
            "depth_m": number("of the target along the optical axis, m"),
            "depth_sigma_m": number("standard deviation of that, m"),
            "range_by": text(
                "what it rests on, the surest first: depth, size, ground, rangefinder, with + between"
            ),
            "range_against": text("what contradicts it and is not believed"),
            "point_v_m": numbers("the target in the marker's frame, m"),
            "gravity_v": numbers("direction of gravity in the marker's frame, unit vector"),
            "sigma_m": number("standard deviation of the point, m"),
            "reason": reason("nothing was sent"),
            "beside": numbers(
                "objects beside the target, six each: box x y w h in px, depth, its deviation in m or 0"
            ),
        },
    ),
    "/both_views": Topic(
        "D2's own reckoning of the target's place from both drones' views, for one answer; none of it is sent",
        {
            "sequence": whole("of D2's answer"),
            "point_v_m": numbers("the target in the marker's frame, m, as D1 means it"),
            "sigma_m": number("standard deviation of that where it is the least sure, m"),
            "depth_m": number("of the target along D2's optical axis, m"),
            "depth_sigma_m": number("standard deviation of that, m"),
            "range_by": text("what that rests on most: views, depth, size"),
            "chi2": number("of D2's line of sight against D1's point, two degrees of freedom"),
            "agree": flag(
                "no more than happens to one in a thousand; else the point is D1's alone"
            ),
        },
    ),
    "/agreement": Topic(
        "D1 judged an answer of D2, or that none came",
        {
            "agreed": flag("both views show the same thing"),
            "counted": flag("it advanced or restarted the count"),
            "reason": reason("it did not agree"),
            "iou": number("overlap of D1's box and D2's mapped one, 0 to 1"),
            "tau": number("overlap that was needed; left out when nothing was compared"),
            "count": whole("agreeing pairs in a row"),
            "needed": whole("of them for a hand-over"),
            "evidence": number("of the gate by evidence, nats"),
            "evidence_needed": number("nats"),
            "capture_ns": whole("of D2's frame, ns of D1's clock"),
            "sequence": whole("of D2's answer"),
            "target_sequence": whole("of the frame of D1 that D2 used"),
            "target_id": whole("of the target"),
            "epoch": whole("of the answer"),
            "own_box": box("D1's, at the capture of D2's frame"),
            "mapped_box": box("D2's, mapped into D1's image"),
            "offset_m": numbers("of D2's box from D1's, in D1's image at the target's depth, m"),
            "rival_offset_m": numbers("the same from the nearest other object that D1 sees, m"),
            "oversize": number(
                "by how much a box is larger than the target can be, standard deviations"
            ),
            "placed_iou": number(
                "overlap with D2's box where a body of the stated size has its middle, 0 to 1"
            ),
        },
    ),
    # --- D2 ---
    "/heard_target": Topic(
        "a message of D1 as it came in, once the clocks are aligned",
        {
            **ATTEMPT,
            "sequence": whole("low 16 bits of D1's frame"),
            "peer_capture_ns": whole("of D1's frame, ns of D1's clock"),
            "capture_ns": whole("the same, ns of D2's clock"),
            "point_v_m": numbers("the target in the marker's frame, m"),
            "gravity_v": numbers("direction of gravity in the marker's frame, unit vector"),
            "sigma_m": number("standard deviation of the point, m"),
        },
    ),
    "/marker": Topic(
        "one frame of D2: its camera in the frame of D1's marker",
        {
            "capture_ns": CAPTURE,
            "position_v_m": numbers("of the camera in the marker's frame, m"),
            "rotation_v_c2": numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": number("standard deviation of the position, each axis, m"),
            "side_px": number("side of the marker in the image, px"),
            "corners_px": numbers("u, v of the four corners, px; the first marker of several"),
            "carried_by": text('"common_view" where that carries the pose, and no marker is seen'),
            "reason": reason("there is no pose"),
            "cause": text("what is likely wrong then, for the crew, where that can be told"),
        },
    ),
    "/common_view": Topic(
        "where D1's marker is by what both cameras see: some frames of D2",
        {
            "capture_ns": CAPTURE,
            "age_s": number("of D1's keyframe then, s"),
            "why": text("why the pose is not known (docs/common-view.md); null: it is"),
            "refused": text("why the filter did not take it; null: it did"),
            "T_c_v": numbers(
                "the marker's pose in the camera: three rows of its matrix, one after another, m"
            ),
            "sigma_m": number("standard deviation of its place, each axis, m"),
            "corners": whole("corners that look alike where they would be the same"),
            "evidence": number("log-likelihood ratio to any other place"),
            "agreement": number("share of common points that agree, 0 to 1"),
            "conflict": number("share that lies in front of what the other measured, 0 to 1"),
        },
    ),
    "/motion": Topic(
        "with each /marker, what the filter of the relative pose was given",
        {
            "own_stamp_ns": whole("of the vehicle's own velocity, ns"),
            "own_n_mps": numbers("north, east, down in m/s"),
            "peer_stamp_ns": whole("of the other drone's velocity, ns of this log's clock"),
            "peer_n_mps": numbers("north, east, down in m/s"),
            "peer_yaw_rad": number("heading of the other drone from north, rad"),
            "q_n_c": numbers("camera to north-east-down as reported, quaternion wxyz"),
            "q_n_v": numbers("marker's frame to north-east-down as reported, quaternion wxyz"),
            "T_c_v": numbers(
                "the marker's pose in the camera: three rows of its matrix, one after another, m"
            ),
            "covariance": numbers("of that pose, 6 x 6 by rows; convention of path.cycle.prior"),
        },
    ),
    "/candidate": Topic(
        "D2's answer for one frame",
        {
            "epoch": whole("of the attempt"),
            "sequence": whole("low 16 bits of the frame's id"),
            "target_sequence": whole("of the newest message of D1 that was used"),
            "capture_ns": CAPTURE,
            "box": box("what D2 takes for the target"),
            "reason": reason("there is no box"),
            "position_v_m": numbers("of D2's camera in the marker's frame, m"),
            "rotation_v_c2": numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": number("standard deviation of the position, each axis, m"),
            "point_v_m": numbers("the target's point as carried to the capture, marker's frame, m"),
            "prior_px": numbers("[u, v] where the target must appear, px"),
            "region": numbers("[x0, y0, x1, y1] of the image that was searched, px"),
            "found": tables(
                "what the detector found there",
                box=numbers("[x, y, w, h], px"),
                score=number("0 to 1"),
            ),
        },
    ),
}
