"""Pocketsphinx over what the microphone hears: listen.py NAME [PHRASE]. With a phrase it waits for that one alone;
otherwise it recognizes all words of Debian's English model. It publishes them as /NAME."""

import sys

import rospy
from pocketsphinx.pocketsphinx import Decoder
from std_msgs.msg import String, UInt8MultiArray

MODEL = "/usr/share/pocketsphinx/model/en-us"
name, phrase = sys.argv[1], " ".join(sys.argv[2:])
config = Decoder.default_config()
config.set_string("-hmm", f"{MODEL}/en-us")
config.set_string("-dict", f"{MODEL}/cmudict-en-us.dict")
config.set_string("-logfn", "/dev/null")
if phrase:
    config.set_string("-keyphrase", phrase)
    config.set_float("-kws_threshold", 1e-30)
else:
    config.set_string("-lm", f"{MODEL}/en-us.lm.bin")
decoder, spoken = Decoder(config), False
decoder.start_utt()
rospy.init_node(name)
words = rospy.Publisher(f"/{name}", String, queue_size=5)


def heard(said):
    global spoken
    decoder.process_raw(bytes(said.data), False, False)
    before, spoken = spoken, decoder.get_in_speech()
    if (before and not spoken) or (phrase and decoder.hyp()):
        decoder.end_utt()
        if decoder.hyp():
            words.publish(decoder.hyp().hypstr)
        decoder.start_utt()


rospy.Subscriber("/audio", UInt8MultiArray, heard, queue_size=50)
rospy.spin()
