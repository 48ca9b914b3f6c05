#!/bin/sh
# All tests: tests/all.sh PYTEST LOG. Those of hostile input and of properties run beside the others, at a lower
# priority and into LOG, since the others wait most of the time. Ends as pytest does; where either run did not come to
# its end, RORG_TEST_FAILED, which would tell what failed, is taken away.
pytest=$1 log=$2
nice -n 5 "$pytest" tests/hostile tests/test_properties.py >"$log" 2>&1 &
beside=$!
trap 'kill -INT $beside' INT TERM
"$pytest" --ignore tests/hostile --ignore tests/test_properties.py
others=$?
wait $beside
hostile=$?
cat "$log"
for code in $others $hostile; do
  case $code in
  0 | 1) ;;
  *)
    rm -f "$RORG_TEST_FAILED"
    exit "$code"
    ;;
  esac
done
[ $others = 0 ] && [ $hostile = 0 ]
