"""The surface of a body and what touches it: closest points, signed distance, collision loss, push-out, penetration."""
