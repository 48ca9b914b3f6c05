#!/bin/sh
# All tests but those of ROS 2 (`make ros2`): tests/all.sh PYTEST FOLDER. In five runs beside each other, since most
# tests wait most of the time: those that need Docker, in two parts by name with an engine each, of which the first has
# all that need rorg's own image; of the others those of hostile input and of properties, and the rest in three parts by
# name, the last beside these. What is printed by all but one is in FOLDER, and shown at the end.
# Ends as pytest does; where a run did not come to its end, RORG_TEST_FAILED, which would tell what failed, is taken
# away.
pytest=$1 logs=$2
mkdir -p "$logs"
RORG_TEST_SHARED=$(mktemp -d)  # what one run has made, as a wheel, is there for the others
export RORG_TEST_SHARED
trap 'rm -rf "$RORG_TEST_SHARED"' EXIT
"$pytest" -m "not docker" tests/hostile tests/proof tests/test_properties.py tests/test_[s-z]*.py >"$logs/hostile" 2>&1 &
hostile=$!
"$pytest" -m "not docker" tests/bounded tests/deployment tests/mutants tests/soak_random tests/test_[a-f]*.py >"$logs/first" 2>&1 &
first=$!
"$pytest" -m "not docker" tests/test_[!a-fs-z]*.py --deselect tests/test_properties.py >"$logs/second" 2>&1 &
second=$!
"$pytest" -m docker tests/hostile tests/test_[a-q]*.py tests/test_tutorial.py >"$logs/docker" 2>&1 &
docker=$!
trap 'kill -INT $hostile $first $second $docker' INT TERM
"$pytest" -m docker tests/deployment tests/soak_random $(ls tests/test_[r-z]*.py | grep -v -e ros2 -e test_tutorial.py)
codes=$?
for run in $docker $first $second $hostile; do
  wait $run
  codes="$codes $?"
done
cat "$logs/docker" "$logs/first" "$logs/second" "$logs/hostile"
for code in $codes; do
  case $code in
  0) ;;
  1) failed=1 ;;
  *)
    rm -f "$RORG_TEST_FAILED"
    exit "$code"
    ;;
  esac
done
exit "${failed:-0}"
