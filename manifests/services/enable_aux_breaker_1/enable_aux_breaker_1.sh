#!/bin/sh
# Asks the base to switch the breaker on. A stand-in reads none of this.
exec rosservice call /enable_aux_breaker_1
