"""Words in the chosen language: templates, and sentences that are filled in already."""

import pytest

from protocol.language import say, translated


def test_a_template_is_said_with_its_values() -> None:
    assert say("{count} units are on the line.", count=3, language="zh") == "3 件产品已投入产线。"
    assert say("No such words {x}", x=1, language="zh") == "No such words 1"


@pytest.mark.parametrize(
    ("sentence", "chinese"),
    [
        ("The unit 'parsec' is not known.", "未知的单位“parsec”。"),
        ("No Zenoh router answers at tcp/127.0.0.1:7447.", "tcp/127.0.0.1:7447 处没有 Zenoh 路由器应答。"),
        ("There is no recording.json.", "没有 recording.json。"),
        ("choose one of: gnc_module.", "请选择以下之一：gnc_module。"),
        ("noise of gyro_x: white noise (posterior 0.16)", "gyro_x 的噪声：白噪声（后验概率 0.16）"),
        ("What no template makes.", "What no template makes."),
        ("", ""),
    ],
)
def test_a_sentence_that_is_filled_in_is_recognised(sentence: str, chinese: str) -> None:
    assert translated(sentence, "zh") == chinese
    assert translated(sentence, "en") == sentence


def test_the_template_with_the_most_words_of_its_own_is_taken() -> None:
    assert "use one of" not in translated("use one of: rad, deg.", "zh")
    refused = "The folder /x/{y} holds a run already."  # braces of the value are not fields
    assert translated(refused, "zh") == "文件夹 /x/{y} 中已有一次运行。"
