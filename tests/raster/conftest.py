import sys
from pathlib import Path

# what the algorithms' tests share is imported as `lod.name`
sys.path.insert(0, str(Path(__file__).parents[1]))
