"""Pole-zero cancelling filters: delays whose zeros cancel a plant's poles, with poles that cancel its zeros (post-actuation)."""
