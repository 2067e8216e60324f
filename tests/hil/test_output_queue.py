"""What a person sees is written by a thread: blocked, broken or failing, it delays nobody."""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
import time

from hil.files.text import plain
from hil.run.session.event_loop import session_result
from hil.run.session.output_queue import LONGEST, OutputQueue, queued_output


def test_an_output_that_blocks_delays_nobody_and_drops_what_does_not_fit():
    let_go = threading.Event()
    output = OutputQueue()
    began = time.monotonic()
    for _ in range(LONGEST + 100):
        output.put(let_go.wait)
    assert time.monotonic() - began < 1.0
    assert output.dropped >= 99
    assert not output.close(0.1)
    let_go.set()


def test_what_is_put_is_written_in_its_order_before_the_end():
    seen: list[int] = []
    output = OutputQueue()
    for number in range(100):
        output.put(seen.append, number)
    assert output.close(5.0)
    assert seen == list(range(100))


def test_a_reader_that_is_gone_ends_the_output_and_nothing_else():
    calls: list[int] = []

    def gone(number: int) -> None:
        calls.append(number)
        raise SystemExit(1)  # what rich makes of a broken pipe

    output = OutputQueue()
    output.put(gone, 1)
    output.put(gone, 2)
    assert output.close(5.0)
    assert calls == [1]


def test_a_call_that_fails_does_not_take_the_next_one():
    seen: list[str] = []
    output = OutputQueue()
    output.put(lambda: 1 / 0)
    output.put(seen.append, "next")
    assert output.close(5.0)
    assert seen == ["next"]


def test_log_and_errors_of_threads_are_lines_of_the_output_and_no_tracebacks(capfd):
    said: list[str] = []
    with queued_output(None, said.append) as (_, announce):
        announce("before")
        try:
            raise OSError("no descriptor left")
        except OSError:
            logging.getLogger("asyncio").exception("accept failed\nsocket: ...")
        thread = threading.Thread(target=lambda: 1 / 0, name="can")
        thread.start()
        thread.join()
    assert said == [
        "before",
        "accept failed: no descriptor left",
        "the thread can ended: ZeroDivisionError: division by zero",
    ]
    assert "Traceback" not in capfd.readouterr().err


def test_text_from_any_terminal_can_be_stored_and_shown():
    assert plain("K\udcfchlung") == "K\\xfchlung"
    assert plain("\ud800 \x1b[31mred\x00") == "\\ud800  [31mred "
    assert plain("ü 😀\n", 10) == "ü 😀\n"
    assert plain("x" * 5000, 20) == "x" * 19 + "…"
    plain("\udcff\ud800" * 2000).encode()


def test_an_error_in_a_callback_of_the_loop_is_told_in_one_line(caplog):
    async def session() -> int:
        loop = asyncio.get_running_loop()
        listener = socket.socket()
        listener.close()
        loop.call_soon(lambda: loop.add_reader(listener.fileno(), print))  # as asyncio does after a lack of descriptors
        await asyncio.sleep(0.01)
        return 7

    assert session_result(session()) == 7
    (record,) = caplog.records
    assert record.exc_info is None and "Invalid file descriptor" in record.getMessage()
