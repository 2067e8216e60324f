"""Prior knowledge of a rig from its healthy record: noise, tunables and model error."""
